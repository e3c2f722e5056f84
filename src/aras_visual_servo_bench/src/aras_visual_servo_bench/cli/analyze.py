"""`bench analyze RUN... --out DIR`, a report of bags, runs of studies and experiments; and
`bench convert BAG`, a bag for Foxglove."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..errors import BenchError, check_formats
from ..loading import load_run
from ..metrics.formatting import make_printable
from ..recording.run import Run
from ..studies.progress import ProgressBar


def add_parser(commands: Any) -> None:
    """The command's own parser."""
    analyze = commands.add_parser("analyze", help="a report of recorded runs, with all curves")
    add_arguments(analyze)
    analyze.set_defaults(carry_out=carry_out)
    convert = commands.add_parser("convert", help="a bag as an MCAP file, which Foxglove reads")
    convert.add_argument("bag", type=Path, help="of ROS")
    convert.add_argument("--out", type=Path, metavar="FILE", help="default: beside the bag, .mcap")
    convert.set_defaults(carry_out=_convert)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What is analyzed, and into what."""
    parser.add_argument(
        "runs", nargs="+", metavar="RUN",
        help="a bag, a folder that the demo wrote, a study's run as DIR:NUMBER, or an experiment's "
             "YAML file; several are compared",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="of the report")
    parser.add_argument("--formats", default="png,svg,pdf", metavar="png,svg,pdf",
                        help="of the figures: %(default)s")
    parser.add_argument("--paper", action="store_true",
                        help="figures for a paper's column: vectors, 8 point serif letters")
    parser.add_argument("--names", default="", metavar="NAMES",
                        help="of the runs in legends, with commas")


def carry_out(options: argparse.Namespace) -> int:
    """Read, draw, write; the page's path is printed."""
    from ..plots.style import FILE_FORMATS

    kinds = [kind.strip() for kind in options.formats.split(",") if kind.strip()]
    check_formats(kinds, FILE_FORMATS)  # before a minute of reading
    names = [name.strip() for name in options.names.split(",") if name.strip()]
    if names and len(names) != len(options.runs):
        raise BenchError(f"{len(names)} names for {len(options.runs)} runs")
    bar = ProgressBar(sys.stderr)
    try:
        runs = []
        for i, given in enumerate(options.runs):
            low, each = 0.5 * i / len(options.runs), 0.5 / len(options.runs)
            run = load_run(given, lambda part, low=low, each=each, given=given: bar.show(
                low + each * part, f"reading {given}"))  # fmt: skip
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
    """Write the runs' report into `out`, unless that is None, and print what came of them."""
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
        print(f"\n{len(written)} files, the page is {make_printable(written[0])}")


def _number_equal_names(runs: list[Run]) -> None:
    """Runs of one name get numbers."""
    names = [run.name for run in runs]
    for i, run in enumerate(runs):
        if names.count(run.name) > 1:
            run.name = f"{run.name} ({i + 1})"


def _convert(options: argparse.Namespace) -> int:
    """Write the file; how many messages it has is printed."""
    if not options.bag.is_file():
        raise BenchError(f"there is no file {options.bag}")
    try:
        from ..ros.mcap import convert
    except ImportError as error:
        raise BenchError(f"needs ROS's Python packages and mcap, see ./setup.sh: {error}") from None
    out = options.out or options.bag.with_name(options.bag.name.split(".")[0] + ".mcap")
    bar = ProgressBar(sys.stderr)
    try:
        counts = convert(options.bag, out, lambda part: bar.show(part, f"converting {options.bag}"))
    finally:
        bar.close()
    print(f"{out}: {sum(counts.values())} messages of {len(counts)} topics")
    return 0
