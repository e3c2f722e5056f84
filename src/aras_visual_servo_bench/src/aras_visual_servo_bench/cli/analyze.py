"""`bench analyze RUN... --out DIR` writes a report; `bench convert BAG` makes an MCAP file."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..errors import BenchError, check_formats
from ..loading import load_run
from ..metrics.formatting import make_printable
from ..progress_bar import ProgressBar
from ..recording.run import Run


def add_parser(commands: Any) -> None:
    """Add the parsers of `analyze` and `convert`."""
    analyze = commands.add_parser("analyze", help="write a report of one or more runs")
    add_arguments(analyze)
    analyze.set_defaults(carry_out=carry_out)
    convert = commands.add_parser("convert", help="convert a bag to an MCAP file for Foxglove")
    convert.add_argument("bag", type=Path, help="bag of ROS")
    convert.add_argument("--out", type=Path, metavar="FILE",
                         help="output file (default: next to the bag, with .mcap)")
    convert.set_defaults(carry_out=_convert)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `analyze`."""
    parser.add_argument(
        "runs", nargs="+", metavar="RUN",
        help="a bag, an output folder of the demo, a run of a study as DIR:NUMBER, or an "
             "experiment's YAML file; several runs are compared",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, required=True, metavar="DIR",
                        help="folder of the report")
    parser.add_argument("--formats", default="png,svg,pdf", metavar="png,svg,pdf",
                        help="formats of the figures (default %(default)s)")
    parser.add_argument("--paper", action="store_true",
                        help="draw figures for a paper's column: vector formats, 8 pt serif font")
    parser.add_argument("--names", default="", metavar="NAMES",
                        help="comma-separated names of the runs in legends")


def carry_out(options: argparse.Namespace) -> int:
    """Read runs, write their report, and print the path of the report's page."""
    from ..plots.style import FILE_FORMATS

    kinds = [kind.strip() for kind in options.formats.split(",") if kind.strip()]
    check_formats(kinds, FILE_FORMATS)  # before the runs are read, which may take a minute
    names = [name.strip() for name in options.names.split(",") if name.strip()]
    if names and len(names) != len(options.runs):
        raise BenchError(f"--names has {len(names)} names for {len(options.runs)} runs: give as "
                         "many names as runs")
    bar = ProgressBar(sys.stderr)
    try:
        runs = []
        for i, path in enumerate(options.runs):
            low, each = 0.5 * i / len(options.runs), 0.5 / len(options.runs)
            run = load_run(path, lambda part, low=low, each=each, path=path: bar.show(
                low + each * part, f"reading {path}"))  # fmt: skip
            run.name = make_printable(names[i] if names else run.name)
            runs.append(run)
        _number_equal_names(runs)
    finally:
        bar.close()
    write_reports(runs, options.out, kinds, options.paper)
    return 0


def write_reports(
    runs: list[Run], out: Path | None, kinds: Sequence[str] = ("png",), paper: bool = False
) -> None:
    """Print the summaries of runs and, if `out` is not None, write their report into `out`."""
    from ..metrics.summary import describe_run, summarise
    from ..web.report.write import write_report

    written = []
    if out is not None:
        bar = ProgressBar(sys.stderr)
        try:
            written = write_report(
                runs, out, kinds, paper, lambda part, what: bar.show(0.5 + 0.5 * part, what)
            )
        finally:
            bar.close()
    for run in runs:
        print(f"\n{run.name}:\n{describe_run(run, summarise(run))}")
        for note in run.notes:
            print(f"  Note: {note}")
    if written:
        print(f"\nwrote {len(written)} files; the page is {make_printable(written[0])}")


def _number_equal_names(runs: list[Run]) -> None:
    """Append a number to the names of runs that have the same name."""
    names = [run.name for run in runs]
    for i, run in enumerate(runs):
        if names.count(run.name) > 1:
            run.name = f"{run.name} ({i + 1})"


def _convert(options: argparse.Namespace) -> int:
    """Convert a bag to an MCAP file, and print the number of its messages."""
    if not options.bag.is_file():
        raise BenchError(f"there is no file {options.bag}")
    try:
        from ..ros.mcap import convert
    except ImportError as error:
        raise BenchError(
            f"convert needs the Python packages of ROS and mcap, see ./setup.sh: {error}"
        ) from None
    out = options.out or options.bag.with_name(options.bag.name.split(".")[0] + ".mcap")
    bar = ProgressBar(sys.stderr)
    try:
        counts = convert(options.bag, out, lambda part: bar.show(part, f"converting {options.bag}"))
    finally:
        bar.close()
    print(f"{out}: {sum(counts.values())} messages of {len(counts)} topics")
    return 0
