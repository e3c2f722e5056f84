"""Command line of the bench: `arguments` declares the commands, the other modules run them."""

from __future__ import annotations

import sys
import time

from aras_visual_servo_base import compile_packages

from ..errors import BenchError, find_program_name
from .arguments import make_parser

# Packages with compiled functions; an installation by pip compiles them at the first simulation.
COMPILED_PACKAGES = ("aras_visual_servo_base", "aras_sim_bridge", "aras_visual_servo_camera",
            "aras_visual_servo_controller", "aras_visual_servo_bench")  # fmt: skip

SIMULATING_COMMANDS = ("run", "resume", "protocol", "dataset", "show", "tune", "analyze")


def _compile_loops() -> None:
    """Compile all functions that are not compiled yet, on all cores, and print messages."""
    missing = compile_packages.find_missing(COMPILED_PACKAGES)
    if missing:
        start = time.monotonic()
        print("first simulation: compiling for one or two minutes", file=sys.stderr, flush=True)
        if compile_packages.main(missing) == 0:
            print(f"compiled in {time.monotonic() - start:.0f} s", file=sys.stderr)


def main(argv: list[str] | None = None) -> int:
    """Run a command, and return its exit status.

    The status is 0 for success, 1 after an error message, 2 for invalid arguments, 130 after ^C.
    """
    parser = make_parser()
    options, remaining = parser.parse_known_args(argv)
    overrides = [word for word in remaining if "=" in word and not word.startswith("-")]
    if len(overrides) < len(remaining) or (remaining and "overrides" not in options):
        parser.error(f"unknown argument {remaining[0]}")
    if remaining:  # argparse does not assign positional arguments that follow an option
        options.overrides += overrides
    try:
        if options.command in SIMULATING_COMMANDS and find_program_name() != "bench":
            _compile_loops()
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
