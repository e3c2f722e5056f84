"""Detection of angles that are probably in degrees instead of radians."""

import math
from collections.abc import Sequence

# If a limit of a revolute joint exceeds this number of turns, it is probably in degrees: the cables
# of a real arm do not allow so many turns.
_FEWEST_TURNS = 3


def describe_angles_in_degrees(angles: Sequence[float], where: str) -> list[str]:
    """Return a warning if an angle is larger than one turn and is a multiple of 5.

    Args:
        where: name of the angles in the message ("link 'a', visual 1: rpy").
    """
    given = [angle for angle in angles if abs(angle) > 2.0 * math.pi and angle % 5.0 == 0.0]
    return [f"{where} {_format_list(angles)} must be in radians, but looks like degrees; write "
            f"{_format_list([math.radians(angle) for angle in angles])}"] if given else []


def describe_limits_in_degrees(lower: float | None, upper: float | None, where: str) -> list[str]:
    """Return a warning if the limits of a revolute joint are probably integers in degrees."""
    bounds = [bound for bound in (lower, upper) if bound is not None]
    far = max(map(abs, bounds), default=0.0)
    if not (2.0 * math.pi * _FEWEST_TURNS < far <= 720.0 and all(
            bound == int(bound) for bound in bounds)):
        return []
    return [
        f"{where}: its limits {_format_list(bounds)} must be in radians, but look like degrees; "
        f"write {_format_list([math.radians(bound) for bound in bounds])}"
    ]


def _format_list(values: Sequence[float]) -> str:
    return " ".join(f"{value:.5g}" for value in values)
