"""The bench's command line: run, resume, table, plot, diff, show, tune, analyze and
convert."""

from __future__ import annotations

import argparse
import sys

from ..errors import BenchError


def parser() -> argparse.ArgumentParser:
    """All commands; what each takes is told where it is carried out.

    Raises:
        BenchError: a library is missing, as where the workspace was set up for the demo alone.
    """
    try:
        from . import analyzing, looking, reading, running
    except ModuleNotFoundError as error:
        raise BenchError(f"{error.name} is not installed: ./setup.sh installs it") from None
    made = argparse.ArgumentParser(prog="bench", description=__doc__.splitlines()[0])
    commands = made.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for part in (running, reading, looking, analyzing):
        part.add(commands)
    return made


def main(argv: list[str] | None = None) -> int:
    """Carry a command out; what cannot be is one line and 1, a wrong call 2."""
    try:
        made = parser()
    except BenchError as error:
        print(f"bench: {error}", file=sys.stderr)
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
        print(f"bench: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("bench: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # as in `bench table DIR | head`
        sys.stderr.close()
        return 1
