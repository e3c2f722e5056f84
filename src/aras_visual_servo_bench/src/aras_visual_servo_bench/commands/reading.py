"""`bench table DIR...`, `plot DIR...` and `diff DIR DIR`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..errors import check_formats, writing
from ..study import compare, tables
from ..study.results import Results


def add(commands: Any) -> None:
    """The commands' own parsers."""
    table = commands.add_parser("table", help="results as a table, with intervals")
    table.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="of a study")
    table.add_argument("--format", default="md", metavar="md|csv|tex", help="%(default)s")
    table.add_argument("--out", type=Path, metavar="FILE", help="into a file")
    table.set_defaults(carry_out=_table)
    plot = commands.add_parser("plot", help="pictures of the results")
    plot.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="of a study")
    plot.add_argument("--format", default="png", metavar="png,svg,pdf", help="%(default)s")
    plot.add_argument("--out", type=Path, metavar="DIR", help="default: plots in the first folder")
    plot.set_defaults(carry_out=_plot)
    diff = commands.add_parser("diff", help="which differences are more than chance")
    diff.add_argument("folders", nargs=2, type=Path, metavar="DIR", help="of a study")
    diff.add_argument("--all", action="store_true", help="those that chance explains too")
    diff.set_defaults(carry_out=_diff)
    for one in (table, diff):
        one.add_argument("--by", default="", metavar="KEYS", help="that make a row, with commas")
    for one in (table, plot, diff):
        one.add_argument("--metrics", default="", metavar="NAMES", help="with commas")


def _words(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


def _table(options: argparse.Namespace) -> int:
    check_formats([options.format], tables.FORMATS)
    found = [Results.read(folder) for folder in options.folders]
    text = tables.written(
        tables.tabulated(found, _words(options.by), _words(options.metrics)), options.format
    )
    if options.out is None:
        print(text, end="")
        return 0
    with writing(options.out):
        options.out.write_text(text, encoding="utf-8")
    return 0


def _plot(options: argparse.Namespace) -> int:
    from ..pictures import figures  # half a second that the others need not wait for

    found = [Results.read(folder) for folder in options.folders]
    out = options.out or options.folders[0] / "plots"
    written = figures.write_all(
        found, out, _words(options.format), _words(options.metrics), options.folders
    )
    for path in written:
        print(path)
    return 0


def _diff(options: argparse.Namespace) -> int:
    first, second = (Results.read(folder) for folder in options.folders)
    found = compare.differences(first, second, _words(options.by), _words(options.metrics))
    print(compare.told(found, options.all))
    return 0
