"""`bench table`, `plot` and `diff` show and compare the results of studies."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..errors import StudyError, catch_write_errors, check_formats
from ..studies import captions, compare, tables
from ..studies.results import Results


def add_parsers(commands: Any) -> None:
    """Add the parsers of `table`, `plot` and `diff`."""
    table = commands.add_parser("table", help="print a table of results with confidence intervals")
    table.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="study folder")
    table.add_argument("--format", default="md", metavar="md|csv|tex",
                       help="format (default %(default)s)")
    table.add_argument("--out", type=Path, metavar="FILE", help="write the table into a file")
    table.set_defaults(carry_out=_print_table)
    plot = commands.add_parser("plot", help="draw figures of the results")
    plot.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="study folder")
    plot.add_argument("--format", default="", metavar="png,svg,pdf",
                      help="formats (default png, with --paper pdf)")
    plot.add_argument("--paper", action="store_true",
                      help="draw figures for a paper's column: 8 pt serif font, and LaTeX captions")
    plot.add_argument("--out", type=Path, metavar="DIR",
                      help="output folder (default: plots in the first study folder)")
    plot.set_defaults(carry_out=_draw_plots)
    diff = commands.add_parser(
        "diff", help="test the differences of two studies, or of the cases of one, for significance"
    )
    diff.add_argument("folders", nargs="+", type=Path, metavar="DIR",
                      help="two study folders, or one with --between")
    diff.add_argument("--between", default="", metavar="KEY",
                      help="compare the values of this key or axis of cases within one study")
    diff.add_argument("--all", action="store_true", help="also list insignificant differences")
    diff.set_defaults(carry_out=_print_differences)
    for one in (table, diff):
        one.add_argument("--by", default="", metavar="KEYS",
                         help="comma-separated keys to group by")
    for one in (table, plot, diff):
        one.add_argument("--metrics", default="", metavar="NAMES",
                         help="comma-separated metrics")


def _split_words(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


def _print_table(options: argparse.Namespace) -> int:
    check_formats([options.format], tables.FORMATS)
    found = [Results.read(folder) for folder in options.folders]
    text = tables.format_table(
        tables.make_table(found, _split_words(options.by), _split_words(options.metrics)),
        options.format,
    )
    if options.out is None:
        print(text, end="")
        return 0
    with catch_write_errors(options.out):
        options.out.write_text(text, encoding="utf-8")
    return 0


def _draw_plots(options: argparse.Namespace) -> int:
    from ..plots import study_figures  # this import takes 0.5 s and is needed only here

    found = [Results.read(folder) for folder in options.folders]
    out = options.out or options.folders[0] / "plots"
    kinds = _split_words(options.format) or ["pdf" if options.paper else "png"]
    written = study_figures.write_figures(
        found, out, kinds, _split_words(options.metrics), options.folders, options.paper
    )
    for path in written:
        print(path)
    return 0


def _print_differences(options: argparse.Namespace) -> int:
    count = 1 if options.between else 2
    if len(options.folders) != count:
        raise StudyError(
            f"diff needs {count} study folder{'s' * (count > 1)}, not {len(options.folders)}: "
            "give two folders, or one folder and --between KEY"
        )
    first, second = ([Results.read(folder) for folder in options.folders] + [None])[:2]
    found = compare.find_differences(
        first, second, _split_words(options.by), _split_words(options.metrics), options.between
    )
    print(compare.describe_differences(found, options.all))
    for line in captions.describe_repeats([first] if second is None else [first, second]):
        print(f"Note: {line}")
    return 0
