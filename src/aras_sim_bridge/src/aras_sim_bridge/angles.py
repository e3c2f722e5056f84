"""Signed distances between angles in rad, computed like those of the ROS package `angles`.

The results agree with `angles` up to rounding. Unlike `angles`, the functions do not return whether
a distance is valid, because ros_control ignores that value.
"""

from math import pi

from aras_visual_servo_base.compiled import jit

TURN = 2.0 * pi


@jit("f8, f8", allocates=False)
def shortest_angular_distance(start, goal):
    """Return the signed distance from `start` to `goal` along the shorter arc, in (-pi, pi]."""
    distance = goal - start
    # Fast path: in nearly every control cycle, the difference is already in (-pi, pi].
    if -pi < distance <= pi:
        return distance
    wrapped = distance % TURN
    return wrapped - TURN if wrapped > pi else wrapped


@jit("f8, f8, f8, f8", allocates=False)
def shortest_angular_distance_with_large_limits(start, goal, lower, upper):
    """Return the shortest signed distance from `start` to `goal` on a path within [lower, upper].

    The limits may span several turns. If neither direction of rotation stays within the limits, or
    if `lower` > `upper`, the shorter distance is returned.
    """
    near = shortest_angular_distance(start, goal)
    far = near - TURN if near > 0.0 else near + TURN
    if lower <= upper and not lower <= start + near <= upper and lower <= start + far <= upper:
        return far
    return near


@jit("f8, f8, f8, f8", allocates=False)
def angular_distance_within_limits(start, goal, lower, upper):
    """Return the shortest signed distance from `start` to `goal` on a path within [lower, upper].

    If `start` is outside the limits, the plain difference `goal` - `start` is returned, which leads
    back into the limits.
    """
    if lower <= start <= upper:
        return shortest_angular_distance_with_large_limits(start, goal, lower, upper)
    return goal - start
