"""`bench analyze RUN... --out DIR` writes a report; `bench convert BAG` makes an MCAP file."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Sequence
from pathlib import Path

from ..errors import BenchError, check_formats
from ..metrics import summary
from ..metrics.formatting import make_printable
from ..progress_bar import ProgressBar
from ..recording.run import Run
from ..run_loading import load_run
from . import compilation


def analyze(options: argparse.Namespace) -> int:
    """Read runs, write their report, and print the path of the report's page."""
    from ..plots.style import FILE_FORMATS

    # A wrong file format is reported before the runs are read, because reading can take a minute.
    check_formats(options.formats, FILE_FORMATS)
    names = options.names
    if names and len(names) != len(options.runs):
        raise BenchError(f"--names has {len(names)} names for {len(options.runs)} runs: give as "
                         "many names as runs")
    # A run of a study is read by simulating it again, which needs Numba.
    compilation.prepare_simulation()
    runs: list[Run] = []
    with contextlib.closing(ProgressBar(sys.stderr)) as bar:
        for i, path in enumerate(options.runs):
            low, each = 0.5 * i / len(options.runs), 0.5 / len(options.runs)
            run = load_run(path, lambda part, low=low, each=each, path=path: bar.show(
                low + each * part, f"reading {path}"))  # fmt: skip
            run.name = make_printable(names[i] if names else run.name)
            runs.append(run)
    given_names = [run.name for run in runs]
    for i, run in enumerate(runs):
        if given_names.count(run.name) > 1:
            run.name = f"{run.name} ({i + 1})"
    write_reports(runs, options.out, options.formats, options.paper)
    return 0


def write_reports(
    runs: list[Run], out: Path | None, kinds: Sequence[str] = ("png",), paper: bool = False
) -> None:
    """Print the summaries of runs and, if `out` is not None, write their report into `out`."""
    written = []
    if out is not None:
        # this import includes matplotlib, which takes 0.5 s
        from ..web.report.write import write_report

        with contextlib.closing(ProgressBar(sys.stderr)) as bar:
            written = write_report(
                runs, out, kinds, paper, lambda part, what: bar.show(0.5 + 0.5 * part, what)
            )
    for run in runs:
        print(f"\n{run.name}:\n{summary.describe_run(run, summary.summarise(run))}")
        for note in run.notes:
            print(f"  Note: {note}")
    if written:
        print(f"\nwrote {len(written)} files; the page is {make_printable(written[0])}")


def convert(options: argparse.Namespace) -> int:
    """Convert a bag to an MCAP file, and print the number of its messages."""
    if not options.bag.is_file():
        raise BenchError(f"there is no file {options.bag}")
    try:
        from ..ros import mcap
    except ImportError as error:
        raise BenchError(
            f"convert needs the Python packages of ROS and mcap, see ./setup.sh: {error}"
        ) from None
    out = options.out or options.bag.with_name(options.bag.name.split(".")[0] + ".mcap")
    with contextlib.closing(ProgressBar(sys.stderr)) as bar:
        counts = mcap.convert(
            options.bag, out, lambda part: bar.show(part, f"converting {options.bag}")
        )
    print(f"{out}: {sum(counts.values())} messages of {len(counts)} topics")
    return 0
