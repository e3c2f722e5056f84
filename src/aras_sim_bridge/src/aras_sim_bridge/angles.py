"""Signed distances between angles, in rad, by the rules of ROS's `is_angle`, which users rely on.

The numbers equal those of the original to rounding; callers of the original ignore whether a
distance is valid, so none of these functions says so.
"""

from math import pi

from aras_visual_servo_base.compiled import jit

TURN = 2.0 * pi


@jit("f8", allocates=False)
def normalize_angle(angle):
    """`angle` in (-pi, pi]."""
    within = angle % TURN
    return within - TURN if within > pi else within


@jit("f8, f8", allocates=False)
def shortest_angular_distance(start, goal):
    """Distance from `start` to `goal` the short way round, in (-pi, pi]."""
    distance = goal - start
    # The case of nearly every control cycle.
    if -pi < distance <= pi:
        return distance
    return normalize_angle(distance)


@jit("f8, f8, f8, f8", allocates=False)
def shortest_angular_distance_with_large_limits(start, goal, lower, upper):
    """Shortest distance that stays within [lower, upper], which may span several turns.

    Where neither way round stays within the limits, or they are crossed, the shorter one.
    """
    near = shortest_angular_distance(start, goal)
    far = near - TURN if near > 0.0 else near + TURN
    if lower <= upper and not lower <= start + near <= upper and lower <= start + far <= upper:
        return far
    return near


@jit("f8, f8, f8, f8", allocates=False)
def angular_distance_within_limits(start, goal, lower, upper):
    """As with_large_limits, but from outside the limits straight to the goal and so back in."""
    if lower <= start <= upper:
        return shortest_angular_distance_with_large_limits(start, goal, lower, upper)
    return goal - start
