"""Conversions between ROS messages and the simulation's own types.

Times are integer nanoseconds of simulated time. The types Pose and Twist are defined in
aras_visual_servo_base.poses.
"""

from __future__ import annotations

import genpy
from geometry_msgs.msg import Point, Quaternion, Vector3
from geometry_msgs.msg import Pose as PoseMessage
from geometry_msgs.msg import Twist as TwistMessage

from aras_sim_bridge.errors import WorldError
from aras_visual_servo_base.pose_checks import check_pose, check_vector
from aras_visual_servo_base.poses import Pose, Twist

# Largest requested position of a model or joint, m or rad. At this distance, double precision still
# resolves 1e-10.
FARTHEST = 1e6
# Largest magnitude of requested velocities, forces and all other values except positions, in SI
# units (m/s, rad/s, N, …). The squares of such values do not overflow.
LARGEST = 1e9


def to_time(time_ns: int) -> genpy.Time:
    """Return the ROS time of a time in integer nanoseconds, without rounding."""
    return genpy.Time(*divmod(time_ns, 1_000_000_000))


def to_duration(seconds: float) -> genpy.Duration:
    """Return the ROS duration of a time in seconds."""
    return genpy.Duration.from_sec(seconds)


def from_time(stamp: genpy.Time | genpy.Duration) -> int:
    """Return the integer nanoseconds of a ROS time or duration."""
    return stamp.secs * 1_000_000_000 + stamp.nsecs


def to_pose(pose: Pose) -> PoseMessage:
    """Return a pose as ROS message."""
    return PoseMessage(Point(*pose.xyz), Quaternion(*pose.quat))


def to_twist(twist: Twist) -> TwistMessage:
    """Return a twist as ROS message."""
    return TwistMessage(Vector3(*twist.linear), Vector3(*twist.angular))


def from_pose(message: PoseMessage, what: str, zero_is_identity: bool = True) -> Pose:
    """Return the pose of a ROS message.

    Args:
        message: pose message.
        what: name of the pose in error messages.
        zero_is_identity: whether the quaternion (0, 0, 0, 0), the default of a message, means no
            rotation. Gazebo interprets it in this way when it spawns or moves a model.

    Raises:
        WorldError: the position is not finite or exceeds FARTHEST, or the orientation is not a
            unit quaternion.
    """
    p, q = message.position, message.orientation
    from_vector(p, f"{what}: position", FARTHEST)
    pose = (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)
    return check_pose(pose, what, WorldError, zero_is_identity)


def from_vector(
    message: Vector3 | Point, what: str, most: float = LARGEST
) -> tuple[float, float, float]:
    """Return (x, y, z) of a message; `what` is the vector's name in error messages.

    Raises:
        WorldError: a number is not finite or its absolute value exceeds `most`.
    """
    return check_bounds(
        check_vector((message.x, message.y, message.z), what, WorldError), what, most
    )


def check_bounds(values: tuple[float, ...], what: str, most: float = LARGEST) -> tuple[float, ...]:
    """Check that each value is finite and within ±`most`, and return the values.

    Raises:
        WorldError: a value is out of bounds; the message starts with `what`.
    """
    if not all(abs(value) <= most for value in values):
        raise WorldError(f"{what}: {values} must be finite and within ±{most:g}")
    return values


def from_twist(message: TwistMessage, what: str) -> Twist:
    """Return the twist of a ROS message; `what` is its name in error messages.

    Raises:
        WorldError: a number is not finite or exceeds LARGEST.
    """
    return Twist(
        from_vector(message.linear, f"{what}: linear velocity"),
        from_vector(message.angular, f"{what}: angular velocity"),
    )
