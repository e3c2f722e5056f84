"""`bench check_interaction FEATURE` compares an interaction matrix with finite differences."""

from __future__ import annotations

import argparse
import traceback

from aras_visual_servo_base.errors import NumbaUnavailableError
from aras_visual_servo_base.names import USER_FAULTS, format_error
from aras_visual_servo_controller.errors import ServoError
from aras_visual_servo_controller.features.interaction_check import check_interaction_matrix

from ..errors import BenchError


def check_interaction(options: argparse.Namespace) -> int:
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
    except NumbaUnavailableError:
        raise
    except USER_FAULTS as error:  # exceptions that the user's feature may raise
        traceback.print_exc()
        raise BenchError(f"{options.feature} raised {format_error(error)}") from error
    return 0
