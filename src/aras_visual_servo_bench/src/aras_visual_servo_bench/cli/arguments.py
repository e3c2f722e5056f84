"""Arguments of all commands; the module of a command is imported only when the command is run."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from aras_visual_servo_base.program import fast_imports
from aras_visual_servo_controller.interaction_check_defaults import STEP, TOLERANCE

from ..errors import find_program_name, make_missing_library_error
from ..studies.cli_defaults import CHUNKS_BEFORE_RESTART

if TYPE_CHECKING:
    Commands = argparse._SubParsersAction[argparse.ArgumentParser]

DESCRIPTION = (
    "Simulated visual servoing: run experiments, studies and protocols, and show their results."
)
EXAMPLES = {
    "run": "run first --out out/first",
    "resume": "resume out/first",
    "protocol": "protocol visp_four_points --out out/visp",
    "table": "table out/first --format tex",
    "plot": "plot out/first --metrics settled",
    "browse": "browse out",
    "diff": "diff out/before out/after",
    "show": "show out/first 12",
    "dataset": "dataset first features=images --views --out out/views",
    "tune": "tune first --over gain=0.5:4 --out out/tuned",
    "analyze": "analyze out/first:12 --out out/report",
    "check_interaction": "check_interaction moments",
    "convert": "convert out/run.bag",
}
PORT = 8090  # first port that the server of `browse` tries
AXIS_OPTIONS = {"case": "scheme", "condition": "condition", "start": "start"}  # option: axis


def make_parser() -> argparse.ArgumentParser:
    """Create the parser of all commands.

    The attribute `carry_out` of the parsed arguments is the function that runs the selected
    command.
    """
    program = find_program_name()
    parser = argparse.ArgumentParser(prog=program, description=DESCRIPTION)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for add in (_add_run, _add_protocol, _add_dataset, _add_results, _add_browse, _add_show,
                _add_tune, _add_analyze, _add_check):  # fmt: skip
        add(commands)
    for name, one in commands.choices.items():
        one.epilog = f"example: {program} {EXAMPLES[name]}"
    return parser


def _split_words(text: str) -> list[str]:
    """Split a comma-separated list."""
    return [word.strip() for word in text.split(",") if word.strip()]


def _set_function(parser: argparse.ArgumentParser, module: str, function: str) -> None:
    """Set the function that runs a command; its module is imported when the command is run.

    Args:
        parser: parser of the command.
        module: name of a module of this package.
        function: name of a function in this module, which receives the parsed arguments.
    """

    def carry_out(options: argparse.Namespace) -> int:
        try:
            with fast_imports():
                imported = import_module(f"..{module}", __name__)
        # the module of this command needs a library that is not installed
        except ModuleNotFoundError as error:
            raise make_missing_library_error(error.name) from None
        run: Callable[[argparse.Namespace], int] = getattr(imported, function)
        return run(options)

    parser.set_defaults(carry_out=carry_out)


def _add_run(commands: Commands) -> None:
    """Add the parsers of `run` and `resume`."""
    run = commands.add_parser("run", help="run an experiment or a study")
    run.add_argument("study", nargs="?", type=Path, metavar="FILE|NAME",
                     help="YAML file of an experiment or a study, or name of a shipped study "
                          "(default: the experiment of the demo)")
    run.add_argument("overrides", nargs="*", metavar="key=value",
                     help="settings to change, for example gain=2.0 or repeats=5")
    run.add_argument("--out", type=Path, help="folder for the results of a study (new, or "
                     "of the same study), or for the report of an experiment")
    run.add_argument("--dry-run", action="store_true", help="only print what would be run")
    _set_function(run, "run_file", "run_file")
    resume = commands.add_parser("resume", help="continue an unfinished study")
    resume.add_argument("folder", type=Path, help="study folder")
    _set_function(resume, "run", "resume")
    for one in (run, resume):
        _add_workers(one)
        one.add_argument("--fail-fast", action="store_true", help="stop after the first failed run")
        one.add_argument("--no-report", action="store_true",
                         help="do not write a table and figures, nor an experiment's report")
        one.add_argument("--mix", action="store_true", help="continue even if the code has changed")


def _add_workers(one: argparse.ArgumentParser) -> None:
    """Add the options of the worker processes."""
    one.add_argument("--workers", type=int, default=0, metavar="N",
                     help="number of processes on this machine (default: one per core)")
    one.add_argument("--in-process", action="store_true",
                     help="run everything in this process, without workers")
    one.add_argument("--scheduler", default="", metavar="ADDRESS",
                     help="address of a Dask scheduler with workers")
    one.add_argument("--cluster", default="", metavar="FILE",
                     help="YAML file with a Dask cluster class, its arguments and its workers")
    # --renew has no default value, so a command can see whether the user has set it. If it would
    # have no effect, the command reports an error.
    one.add_argument("--renew", type=int, metavar="N",
                     help=f"restart workers every N chunks (default {CHUNKS_BEFORE_RESTART})")


def _add_protocol(commands: Commands) -> None:
    parser = commands.add_parser("protocol", help="run a published protocol, and write a table")
    parser.add_argument("study", metavar="NAME", type=Path,
                        help="name of a shipped study, or a study's YAML file")
    parser.add_argument("--out", type=Path, required=True, help="output folder")
    parser.add_argument("--seeds", type=int, help="number of seeds (default: that of the study)")
    parser.add_argument("--first", type=int, help="first seed (default: that of the study)")
    for option in AXIS_OPTIONS:
        parser.add_argument(f"--{option}", action="append",
                            help=f"run only this {option}; can be repeated")
    parser.add_argument("--mix", action="store_true", help="continue even if the code has changed")
    _add_workers(parser)
    parser.set_defaults(fail_fast=False, no_report=True)
    _set_function(parser, "protocol", "run_protocol")


def _add_dataset(commands: Commands) -> None:
    one = commands.add_parser(
        "dataset", help="run a study, and store image, joints, pose and twist of every image")
    one.add_argument("study", type=Path, metavar="FILE|NAME",
                     help="YAML file of a study, or name of a shipped study")
    one.add_argument("overrides", nargs="*", metavar="key=value",
                     help="settings to change, for example repeats=1000 or features=images")
    one.add_argument("--out", type=Path, required=True,
                     help="folder of the data set; an existing one of the same study is continued")
    one.add_argument("--views", action="store_true",
                     help="store only the first image of each run, the view from the start")
    one.add_argument("--depth", action="store_true", help="also store depth images")
    _add_workers(one)
    one.set_defaults(fail_fast=False, no_report=True, mix=False)
    _set_function(one, "dataset", "make_dataset")


def _add_results(commands: Commands) -> None:
    """Add the parsers of `table`, `plot` and `diff`."""
    table = commands.add_parser("table", help="print a table of results with confidence intervals")
    table.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="study folder")
    table.add_argument("--format", default="md", metavar="md|csv|tex",
                       help="format of the table (default %(default)s)")
    table.add_argument("--out", type=Path, metavar="FILE", help="write the table into a file")
    _set_function(table, "results", "print_table")
    plot = commands.add_parser("plot", help="draw figures of the results")
    plot.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="study folder")
    plot.add_argument("--format", type=_split_words, default="", metavar="png,svg,pdf",
                      help="file formats (default: png; with --paper: pdf)")
    plot.add_argument("--paper", action="store_true",
                      help="draw figures in the width of a paper's column, with captions in LaTeX")
    plot.add_argument("--out", type=Path, metavar="DIR",
                      help="output folder (default: plots in the first study folder)")
    _set_function(plot, "results", "draw_plots")
    diff = commands.add_parser(
        "diff", help="test whether two studies, or the cases of one study, differ significantly"
    )
    diff.add_argument("folders", nargs="+", type=Path, metavar="DIR",
                      help="two study folders, or a single one together with --between")
    diff.add_argument("--between", default="", metavar="KEY",
                      help="compare the runs of one study that differ in this key or axis of cases")
    diff.add_argument("--all", action="store_true", help="also list insignificant differences")
    _set_function(diff, "results", "print_differences")
    for one in (table, diff):
        one.add_argument("--by", type=_split_words, default="", metavar="KEYS",
                         help="comma-separated keys to group by")
    for one in (table, plot, diff):
        one.add_argument("--metrics", type=_split_words, default="", metavar="NAMES",
                         help="comma-separated metrics")


def _add_browse(commands: Commands) -> None:
    browse = commands.add_parser("browse", help="filter, plot and open runs in a browser")
    browse.add_argument("folders", nargs="+", type=Path, metavar="DIR",
                        help="folder of a study, or of several studies")
    browse.add_argument("--port", type=int, default=PORT, metavar="N",
                        help="port (default %(default)s); if it is taken, the next free one")
    browse.add_argument("--address", default="127.0.0.1", metavar="IP",
                        help="address (default %(default)s); 0.0.0.0 allows access from other "
                             "machines")
    browse.add_argument("--no-open", action="store_true", help="do not open a browser")
    _set_function(browse, "browse", "browse")


def _add_show(commands: Commands) -> None:
    show = commands.add_parser("show", help="repeat a run of a study and write its report and "
                               "video, or print the experiment of a bag")  # fmt: skip
    show.add_argument("folder", type=Path, metavar="DIR|BAG", help="study folder, or a bag")
    show.add_argument("run", type=int, nargs="?", help="number of the run in the study")
    show.add_argument("--out", type=Path, metavar="DIR", help="folder for the report of a run "
                      "(default: show-RUN in the study folder), or for the experiment, parameters, "
                      "description and goal of a bag")
    _set_function(show, "show_and_tune", "show")


def _add_tune(commands: Commands) -> None:
    tune = commands.add_parser("tune", help="search the settings that optimize a metric")
    tune.add_argument("study", type=Path,
                      help="YAML file of the study with which every candidate is evaluated")
    tune.add_argument("overrides", nargs="*", metavar="key=value",
                      help="settings to change, for example repeats=5")
    tune.add_argument("--over", action="append", default=[], metavar="key=low:high",
                      help="a setting and its range, for example gain=0.5:4; can be repeated")
    tune.add_argument("--metric", default="settled",
                      help="metric to optimize (default %(default)s)")
    tune.add_argument("--evaluations", type=int, default=48, metavar="N",
                      help="number of candidates (default %(default)s)")
    tune.add_argument("--success", type=float, default=1.0, metavar="PART",
                      help="required success rate, 0 to 1 (default %(default)s)")
    tune.add_argument("--out", type=Path, required=True, help="output folder of the candidates")
    _add_workers(tune)
    _set_function(tune, "show_and_tune", "tune")


def _add_analyze(commands: Commands) -> None:
    """Add the parsers of `analyze` and `convert`."""
    analyze = commands.add_parser("analyze", help="write a report of one or more runs")
    analyze.add_argument(
        "runs", nargs="+", metavar="RUN",
        help="a bag, an output folder of the demo, a run of a study as DIR:NUMBER, or an "
             "experiment's YAML file; several runs are compared",
    )  # fmt: skip
    analyze.add_argument("--out", type=Path, required=True, metavar="DIR",
                         help="folder of the report")
    analyze.add_argument("--formats", type=_split_words, default="png,svg,pdf",
                         metavar="png,svg,pdf", help="formats of the figures (default %(default)s)")
    analyze.add_argument("--paper", action="store_true",
                         help="draw figures for a paper's column: vector formats, 8 pt serif font")
    analyze.add_argument("--names", type=_split_words, default="", metavar="NAMES",
                         help="comma-separated names of the runs in legends")
    _set_function(analyze, "analyze", "analyze")
    convert = commands.add_parser("convert", help="convert a bag to an MCAP file for Foxglove")
    convert.add_argument("bag", type=Path, help="ROS bag")
    convert.add_argument("--out", type=Path, metavar="FILE",
                         help="output file (default: next to the bag, with .mcap)")
    _set_function(convert, "analyze", "convert")


def _add_check(commands: Commands) -> None:
    check = commands.add_parser(
        "check_interaction", help="compare a feature's interaction matrix with finite differences"
    )
    check.add_argument("feature", metavar="FEATURE",
                       help="package.module:Class, or name of a built-in feature")
    check.add_argument("--tolerance", type=float, default=TOLERANCE, metavar="PART",
                       help="largest allowed relative error of a row of L (default %(default)s)")
    check.add_argument("--step", type=float, default=STEP, metavar="H",
                       help="step of the finite differences: a fraction of the depth for "
                            "translations, rad for rotations (default %(default)s)")
    _set_function(check, "check_interaction", "check_interaction")
