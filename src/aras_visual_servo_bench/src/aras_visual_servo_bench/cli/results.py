"""`bench table`, `plot` and `diff` show and compare the results of studies."""

from __future__ import annotations

import argparse

from aras_visual_servo_base.lazy_imports import import_without

from ..errors import StudyError, catch_write_errors, check_formats
from ..studies import captions, tables
from ..studies.results import Results

# pyarrow imports pandas, if it is installed, only to recognise pandas objects. The import takes 0.7
# s and is suppressed here, because the commands of this module use no such objects.
import_without("pandas", "pyarrow.dataset")


def print_table(options: argparse.Namespace) -> int:
    """Print a table of results, or write it into a file."""
    check_formats([options.format], tables.FORMATS)
    found = [Results.read(folder) for folder in options.folders]
    table = tables.make_table(found, options.by, options.metrics)
    text = tables.format_table(table, options.format)
    if options.out is None:
        print(text, end="")
        return 0
    with catch_write_errors(options.out):
        options.out.write_text(text, encoding="utf-8")
    return 0


def draw_plots(options: argparse.Namespace) -> int:
    """Draw figures of the results, and print their paths."""
    # this import takes 0.5 s, and not all commands of this module need it
    from ..plots import study_figures

    found = [Results.read(folder) for folder in options.folders]
    out = options.out or options.folders[0] / "plots"
    kinds = options.format or ["pdf" if options.paper else "png"]
    written = study_figures.write_figures(
        found, out, kinds, options.metrics, options.folders, options.paper
    )
    for path in written:
        print(path)
    return 0


def print_differences(options: argparse.Namespace) -> int:
    """Print the significant differences between two studies, or between the cases of one study."""
    count = 1 if options.between else 2
    if len(options.folders) != count:
        raise StudyError(
            f"diff {'with' if options.between else 'without'} --between needs {count} study "
            f"folder{'s' * (count > 1)}, not {len(options.folders)}: give two folders, or one "
            "folder and --between KEY"
        )
    first, second = ([Results.read(folder) for folder in options.folders] + [None])[:2]
    found = first.compare(second, options.by, options.metrics, options.between)
    print(found.describe(options.all))
    for line in captions.describe_repeats([first] if second is None else [first, second]):
        print(f"Note: {line}")
    return 0
