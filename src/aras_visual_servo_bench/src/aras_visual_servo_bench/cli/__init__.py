"""Simulated visual servoing: run experiments, studies and protocols, and show their results."""

from __future__ import annotations

import argparse
import sys
import time

from aras_visual_servo_base import compile_packages

from ..errors import BenchError, find_program_name, make_missing_library_error

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


# Packages with compiled functions; an installation by pip compiles them at the first start.
COMPILED_PACKAGES = ("aras_visual_servo_base", "aras_sim_bridge", "aras_visual_servo_camera",
            "aras_visual_servo_controller", "aras_visual_servo_bench")  # fmt: skip


def _compile_loops() -> None:
    """Compile all functions that are not compiled yet, on all cores, and print messages."""
    missing = compile_packages.find_missing(COMPILED_PACKAGES)
    if missing:
        start = time.monotonic()
        print("first start: compiling for one or two minutes", file=sys.stderr, flush=True)
        if compile_packages.main(missing) == 0:
            print(f"compiled in {time.monotonic() - start:.0f} s", file=sys.stderr)


def make_parser() -> argparse.ArgumentParser:
    """Create the parser of all commands. The module of each command adds its arguments.

    Raises:
        BenchError: a library is missing, for example after a setup for the demo only.
    """
    try:
        from . import analyze, browse, check, dataset, protocol, results, run, show_tune
    except ModuleNotFoundError as error:
        raise make_missing_library_error(error.name) from None
    parser = argparse.ArgumentParser(prog=find_program_name(), description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for add in (
        run.add_parsers,
        protocol.add_parser,
        dataset.add_parser,
        results.add_parsers,
        browse.add_parser,
        show_tune.add_parsers,
        analyze.add_parser,
        check.add_parser,
    ):
        add(commands)
    for name, one in commands.choices.items():
        one.epilog = f"example: {find_program_name()} {EXAMPLES[name]}"
    return parser


def main(argv: list[str] | None = None) -> int:
    """Run a command, and return its exit status.

    The status is 0 for success, 1 after an error message, 2 for invalid arguments, 130 after ^C.
    """
    if find_program_name() != "bench":
        _compile_loops()
    try:
        parser = make_parser()
    except BenchError as error:
        print(f"{find_program_name()}: {error}", file=sys.stderr)
        return 1
    options, remaining = parser.parse_known_args(argv)
    overrides = [word for word in remaining if "=" in word and not word.startswith("-")]
    if len(overrides) < len(remaining) or (remaining and "overrides" not in options):
        parser.error(f"unknown argument {remaining[0]}")
    if remaining:  # argparse does not assign positional arguments that follow an option
        options.overrides += overrides
    try:
        return options.carry_out(options)
    except BenchError as error:
        print(f"{find_program_name()}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"{find_program_name()}: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of the output has ended, as in `bench table DIR | head`
        sys.stderr.close()
        return 1
