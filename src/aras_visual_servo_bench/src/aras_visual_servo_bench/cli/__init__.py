"""Visual servoing, simulated: carry out experiments, studies and protocols, and look at them."""

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
    "convert": "convert out/run.bag",
}


# Those of this workspace with loops, which pip's installation leaves to be compiled.
COMPILED_PACKAGES = ("aras_visual_servo_base", "aras_sim_bridge", "aras_visual_servo_camera",
            "aras_visual_servo_controller", "aras_visual_servo_bench")  # fmt: skip


def _compile_loops() -> None:
    """What ./setup.sh does, where pip installed this program: all cores compile, and it is said."""
    due = compile_packages.find_missing(COMPILED_PACKAGES)
    if due:
        begun = time.monotonic()
        print("compiling loops, once: a minute or two", file=sys.stderr, flush=True)
        if compile_packages.main(due) == 0:
            print(f"compiled in {time.monotonic() - begun:.0f} s", file=sys.stderr)


def make_parser() -> argparse.ArgumentParser:
    """All commands; what each takes is told where it is carried out.

    Raises:
        BenchError: a library is missing, as where the workspace was set up for the demo alone.
    """
    try:
        from . import analyze, browse, dataset, protocol, results, run, show_tune
    except ModuleNotFoundError as error:
        raise make_missing_library_error(error.name) from None
    made = argparse.ArgumentParser(prog=find_program_name(), description=__doc__.splitlines()[0])
    commands = made.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for add in (
        run.add_parsers,
        protocol.add_parser,
        dataset.add_parser,
        results.add_parsers,
        browse.add_parser,
        show_tune.add_parsers,
        analyze.add_parser,
    ):
        add(commands)
    for name, one in commands.choices.items():
        one.epilog = f"example: {find_program_name()} {EXAMPLES[name]}"
    return made


def main(argv: list[str] | None = None) -> int:
    """Carry a command out; what cannot be is one line and 1, a wrong call 2."""
    if find_program_name() != "bench":
        _compile_loops()
    try:
        made = make_parser()
    except BenchError as error:
        print(f"{find_program_name()}: {error}", file=sys.stderr)
        return 1
    options, behind = made.parse_known_args(argv)
    overrides = [word for word in behind if "=" in word and not word.startswith("-")]
    if len(overrides) < len(behind) or (behind and "overrides" not in options):
        made.error(f"unknown argument {behind[0]}")
    if behind:  # argparse takes overrides only before the options
        options.overrides += overrides
    try:
        return options.carry_out(options)
    except BenchError as error:
        print(f"{find_program_name()}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"{find_program_name()}: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # as in `bench table DIR | head`
        sys.stderr.close()
        return 1
