"""Signed distances between angles, in rad, by the rules of ROS's `angles`, which users rely on.

The numbers equal those of the original to rounding; callers of the original ignore whether a
distance is valid, so none of these functions says so.
"""

from math import fmod, pi

TURN = 2.0 * pi


def normalize_angle(angle: float) -> float:
    """`angle` in (-pi, pi]."""
    within = angle % TURN
    return within - TURN if within > pi else within


def shortest(start: float, goal: float) -> float:
    """Distance from `start` to `goal` the short way round, in (-pi, pi]."""
    distance = goal - start
    # The case of nearly every control cycle.
    if -pi < distance <= pi:
        return distance
    return normalize_angle(distance)


def with_large_limits(start: float, goal: float, lower: float, upper: float) -> float:
    """Shortest distance that stays within [lower, upper], which may span several turns.

    Where neither way round stays within the limits, or they are crossed, the shorter one.
    """
    distance = shortest(start, goal)
    near, far = sorted((distance, _other_way(distance)), key=abs)
    if lower <= upper and not lower <= start + near <= upper and lower <= start + far <= upper:
        return far
    return near


def with_limits(start: float, goal: float, lower: float, upper: float) -> float:
    """Distance that does not cross the gap outside [lower, upper]; limits in [-pi, pi].

    From outside the limits, or to a goal outside them, it goes to the nearer limit's side.
    """
    back, ahead, inside = _travel(start, lower, upper)
    distance = shortest(start, goal)
    other = _other_way(distance)
    if inside:
        for candidate in (distance, other):
            if back <= candidate <= ahead:
                return candidate
        back, ahead, _ = _travel(goal, lower, upper)
        back, ahead = ahead, back
    if abs(back) == abs(ahead):
        return min(other, distance, key=abs)
    return (min if abs(back) < abs(ahead) else max)(distance, other)


def _other_way(distance: float) -> float:
    """The same change of angle the other way round; 0 is a full turn."""
    distance = fmod(distance, TURN) if abs(distance) > TURN else distance
    return distance - TURN if distance > 0.0 else distance + TURN


def _travel(angle: float, lower: float, upper: float) -> tuple[float, float, bool]:
    """How far `angle` may go back and ahead to the limits, and whether it is within them."""
    to_lower, to_upper = shortest(angle, lower), shortest(angle, upper)
    others = _other_way(to_lower), _other_way(to_upper)
    if to_lower == 0.0:
        return 0.0, max(to_upper, others[1]), True
    if to_upper == 0.0:
        return min(to_lower, others[0]), 0.0, True
    back, beyond_back = sorted((to_lower, others[0]))
    beyond_ahead, ahead = sorted((to_upper, others[1]))
    if back <= beyond_ahead or ahead >= beyond_back:
        return beyond_ahead, beyond_back, lower == -pi and upper == pi
    return back, ahead, True
