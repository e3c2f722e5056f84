"""Between ROS messages and the plain numbers of the simulation.

Times are integer nanoseconds of simulated time, poses are (xyz [m], quaternion xyzw).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import genpy
from geometry_msgs.msg import Point, Pose, Quaternion, Twist, Vector3

from aras_sim_bridge.errors import SimError


def to_time(time_ns: int) -> genpy.Time:
    """Return a ROS time from integer nanoseconds, without a detour over floats."""
    return genpy.Time(*divmod(time_ns, 1_000_000_000))


def to_duration(seconds: float) -> genpy.Duration:
    """Return a ROS duration from seconds."""
    return genpy.Duration.from_sec(seconds)


def from_time(stamp: genpy.Time) -> int:
    """Return integer nanoseconds from a ROS time or duration."""
    return stamp.secs * 1_000_000_000 + stamp.nsecs


def to_pose(xyz: Sequence[float], quaternion: Sequence[float]) -> Pose:
    """Return a pose message from a position [m] and a quaternion (x, y, z, w)."""
    return Pose(Point(*map(float, xyz)), Quaternion(*map(float, quaternion)))


def to_twist(linear: Sequence[float], angular: Sequence[float]) -> Twist:
    """Return a twist message from linear [m/s] and angular [rad/s] velocity."""
    return Twist(Vector3(*map(float, linear)), Vector3(*map(float, angular)))


def vector(message: Point | Vector3, what: str) -> tuple[float, float, float]:
    """Return (x, y, z); raises SimError naming `what` when one is not finite."""
    values = (message.x, message.y, message.z)
    if not all(map(math.isfinite, values)):
        raise SimError(f"{what} is not finite: {values}")
    return values


def quaternion(message: Quaternion, what: str) -> tuple[float, float, float, float]:
    """Return a unit quaternion (x, y, z, w); all zeros means identity, as Gazebo takes it.

    Raises:
        SimError: naming `what` when a component is not finite.
    """
    values = (message.x, message.y, message.z, message.w)
    if not all(map(math.isfinite, values)):
        raise SimError(f"{what} is not finite: {values}")
    norm = math.sqrt(sum(value * value for value in values))
    if norm < 1e-12:
        return (0.0, 0.0, 0.0, 1.0)
    return tuple(value / norm for value in values)


def pose(message: Pose, what: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return (xyz, quaternion xyzw) of a pose message; raises SimError when not finite."""
    return (
        vector(message.position, f"position of {what}"),
        quaternion(message.orientation, f"orientation of {what}"),
    )


def twist(message: Twist, what: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return (linear, angular) of a twist message; raises SimError when not finite."""
    return (
        vector(message.linear, f"linear velocity of {what}"),
        vector(message.angular, f"angular velocity of {what}"),
    )


def rotate(quaternion: Sequence[float], v: Sequence[float]) -> tuple[float, float, float]:
    """Rotate v by a unit quaternion (x, y, z, w)."""
    x, y, z, w = quaternion
    tx = 2.0 * (y * v[2] - z * v[1])
    ty = 2.0 * (z * v[0] - x * v[2])
    tz = 2.0 * (x * v[1] - y * v[0])
    return (
        v[0] + w * tx + y * tz - z * ty,
        v[1] + w * ty + z * tx - x * tz,
        v[2] + w * tz + x * ty - y * tx,
    )


def multiply(a: Sequence[float], b: Sequence[float]) -> tuple[float, float, float, float]:
    """Return the quaternion product a b (x, y, z, w): first b, then a."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def conjugate(q: Sequence[float]) -> tuple[float, float, float, float]:
    """Return the inverse of a unit quaternion (x, y, z, w)."""
    return (-q[0], -q[1], -q[2], q[3])


def compose(a_T_b: tuple, b_T_c: tuple) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return a_T_c of two poses given as (xyz, quaternion)."""
    moved = rotate(a_T_b[1], b_T_c[0])
    xyz = tuple(p + q for p, q in zip(a_T_b[0], moved, strict=True))
    return xyz, multiply(a_T_b[1], b_T_c[1])


def invert(a_T_b: tuple) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return b_T_a of a pose given as (xyz, quaternion)."""
    inverse = conjugate(a_T_b[1])
    return tuple(-value for value in rotate(inverse, a_T_b[0])), inverse
