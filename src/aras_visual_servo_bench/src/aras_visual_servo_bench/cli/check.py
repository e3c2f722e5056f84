"""`bench check_interaction FEATURE` compares an interaction matrix with finite differences."""

from __future__ import annotations

import argparse
import traceback
from typing import Any

from aras_visual_servo_base.names import USER_FAULTS, format_error
from aras_visual_servo_controller.errors import ServoError
from aras_visual_servo_controller.features.interaction_check import (
    STEP,
    TOLERANCE,
    check_interaction_matrix,
)

from ..errors import BenchError


def add_parser(commands: Any) -> None:
    """Add the parser of `check_interaction`."""
    check = commands.add_parser(
        "check_interaction", help="compare a feature's interaction matrix with finite differences"
    )
    check.add_argument("feature", metavar="FEATURE",
                       help="package.module:Class, or name of a built-in feature")
    check.add_argument("--tolerance", type=float, default=TOLERANCE, metavar="PART",
                       help="largest relative error of a row (default %(default)s)")
    check.add_argument("--step", type=float, default=STEP, metavar="H",
                       help="step of the finite differences: a fraction of the depth for "
                            "translations, rad for rotations (default %(default)s)")
    check.set_defaults(carry_out=_check_interaction)


def _check_interaction(options: argparse.Namespace) -> int:
    """Print the check of a feature; the exit status is 1 if its interaction matrix is wrong."""
    for name in ("tolerance", "step"):
        if not getattr(options, name) > 0.0:
            raise BenchError(f"--{name} is {getattr(options, name):g}, must be above 0")
    try:
        print(check_interaction_matrix(
            options.feature, step=options.step, tolerance=options.tolerance
        ))  # fmt: skip
    except ServoError as error:
        if (check := getattr(error, "check", None)) is None:
            raise BenchError(str(error)) from error
        print(check)
        return 1
    except USER_FAULTS as error:  # the user's feature raised an error
        traceback.print_exc()
        raise BenchError(f"{options.feature} raised {format_error(error)}") from error
    return 0
