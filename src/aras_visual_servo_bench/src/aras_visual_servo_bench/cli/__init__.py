"""Command line of the bench: `arguments` declares the commands, the other modules run them."""

from __future__ import annotations

import sys

from aras_visual_servo_base.errors import NumbaUnavailableError

from ..errors import BenchError, find_program_name
from .arguments import make_parser


def main(argv: list[str] | None = None) -> int:
    """Run a command, and return its exit status.

    The status is 0 for success, 1 after an error message, 2 for invalid arguments, 130 after ^C.
    """
    parser = make_parser()
    options, remaining = parser.parse_known_args(argv)
    overrides = [word for word in remaining if "=" in word and not word.startswith("-")]
    if len(overrides) < len(remaining) or (remaining and "overrides" not in options):
        parser.error(f"unknown argument {remaining[0]}")
    # argparse puts positional arguments into `remaining` if they follow an option
    if remaining:
        options.overrides += overrides
    try:
        return options.carry_out(options)
    except (BenchError, NumbaUnavailableError) as error:
        print(f"{find_program_name()}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"{find_program_name()}: interrupted", file=sys.stderr)
        return 130
    # The program that reads this output, such as `head` in `bench table DIR | head`, has ended.
    except BrokenPipeError:
        sys.stderr.close()
        return 1
