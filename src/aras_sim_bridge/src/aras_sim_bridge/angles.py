"""Signed distances between angles, in rad, by the rules of ROS's `angles`, which users rely on.

The numbers equal those of the original to rounding; callers of the original ignore whether a
distance is valid, so none of these functions says so.
"""

from math import pi

from aras_visual_servo_base.compiled import compiled

TURN = 2.0 * pi


@compiled("f8", allocates=False)
def normalize_angle(angle):
    """`angle` in (-pi, pi]."""
    within = angle % TURN
    return within - TURN if within > pi else within


@compiled("f8, f8", allocates=False)
def shortest(start, goal):
    """Distance from `start` to `goal` the short way round, in (-pi, pi]."""
    distance = goal - start
    # The case of nearly every control cycle.
    if -pi < distance <= pi:
        return distance
    return normalize_angle(distance)


@compiled("f8, f8, f8, f8", allocates=False)
def with_large_limits(start, goal, lower, upper):
    """Shortest distance that stays within [lower, upper], which may span several turns.

    Where neither way round stays within the limits, or they are crossed, the shorter one.
    """
    near = shortest(start, goal)
    far = near - TURN if near > 0.0 else near + TURN
    if lower <= upper and not lower <= start + near <= upper and lower <= start + far <= upper:
        return far
    return near


@compiled("f8, f8, f8, f8", allocates=False)
def towards(start, goal, lower, upper):
    """As with_large_limits, but from outside the limits straight to the goal and so back in."""
    if lower <= start <= upper:
        return with_large_limits(start, goal, lower, upper)
    return goal - start
