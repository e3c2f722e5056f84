"""Numbers that look like degrees where radians belong."""

import math
from collections.abc import Sequence

_FEWEST_TURNS = 3  # of a joint; cables allow no arm more


def describe_angles_in_degrees(angles: Sequence[float], where: str) -> list[str]:
    """A sentence where one of these angles is more than a turn, and a whole number of 5 degrees.

    where: names them in the message ("link 'a', visual 1: rpy").
    """
    given = [angle for angle in angles if abs(angle) > 2.0 * math.pi and angle % 5.0 == 0.0]
    return [f"{where} {_format_list(angles)} is in radians, and looks like degrees; write "
            f"{_format_list([math.radians(angle) for angle in angles])}"] if given else []


def describe_limits_in_degrees(lower: float | None, upper: float | None, where: str) -> list[str]:
    """A sentence where a turning joint's limits are whole degrees rather than many turns."""
    bounds = [bound for bound in (lower, upper) if bound is not None]
    far = max(map(abs, bounds), default=0.0)
    if not (2.0 * math.pi * _FEWEST_TURNS < far <= 720.0 and all(
            bound == int(bound) for bound in bounds)):
        return []
    return [
        f"{where}: its limits {_format_list(bounds)} are in radians, and look like degrees; write "
        f"{_format_list([math.radians(bound) for bound in bounds])}"
    ]


def _format_list(values: Sequence[float]) -> str:
    return " ".join(f"{value:.5g}" for value in values)
