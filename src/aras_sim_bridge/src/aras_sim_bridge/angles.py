"""Signed distances between angles, in rad.

The arithmetic is ROS's own `angles` package (Debian: python3-angles); what is added here is a
short way out for the case of nearly every control cycle, where the plain difference is the answer.
"""

from math import pi

from angles import normalize_angle
from angles import shortest_angular_distance as _shortest
from angles import shortest_angular_distance_with_large_limits as _with_large_limits
from angles import shortest_angular_distance_with_limits as _with_limits

__all__ = ["normalize_angle", "shortest", "with_large_limits", "with_limits"]


def shortest(start: float, goal: float) -> float:
    """Distance from `start` to `goal` the short way round, in (-pi, pi]."""
    distance = goal - start
    if -pi < distance <= pi:
        return distance
    return _shortest(start, goal)


def with_large_limits(start: float, goal: float, lower: float, upper: float) -> float:
    """Shortest distance that stays within [lower, upper], which may span several turns.

    Where neither way round stays within the limits, the shorter one is returned, as the
    callers of the original do: they use the value and ignore its validity.
    """
    distance = goal - start
    if -pi < distance < pi and lower <= start + distance <= upper:
        return distance
    return _with_large_limits(start, goal, lower, upper)[1]


def with_limits(start: float, goal: float, lower: float, upper: float) -> float:
    """Distance that does not cross the gap outside [lower, upper]; limits in [-pi, pi]."""
    return _with_limits(start, goal, lower, upper)[1]
