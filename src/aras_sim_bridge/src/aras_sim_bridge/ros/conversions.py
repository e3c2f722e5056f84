"""Between ROS messages and the plain numbers of the simulation.

Times are integer nanoseconds of simulated time, poses and twists those of
aras_visual_servo_base.poses.
"""

from __future__ import annotations

import genpy
from geometry_msgs.msg import Point, Quaternion, Vector3
from geometry_msgs.msg import Pose as PoseMessage
from geometry_msgs.msg import Twist as TwistMessage

from aras_sim_bridge.errors import WorldError
from aras_visual_servo_base.poses import Pose, Twist, check_pose, check_vector

FARTHEST = 1e6  # m, rad: where a model or a joint can be put; double precision leaves 1e-10 there
LARGEST = 1e9  # m, m/s, rad/s, N: what a client may ask for; squares of more leave the floats


def to_time(time_ns: int) -> genpy.Time:
    """Return a ROS time from integer nanoseconds, without a detour over floats."""
    return genpy.Time(*divmod(time_ns, 1_000_000_000))


def to_duration(seconds: float) -> genpy.Duration:
    """Return a ROS duration from seconds."""
    return genpy.Duration.from_sec(seconds)


def from_time(stamp: genpy.Time | genpy.Duration) -> int:
    """Return integer nanoseconds from a ROS time or duration."""
    return stamp.secs * 1_000_000_000 + stamp.nsecs


def to_pose(pose: Pose) -> PoseMessage:
    """Return the message of a pose."""
    return PoseMessage(Point(*pose.xyz), Quaternion(*pose.quat))


def to_twist(twist: Twist) -> TwistMessage:
    """Return the message of a twist."""
    return TwistMessage(Vector3(*twist.linear), Vector3(*twist.angular))


def from_pose(message: PoseMessage, what: str, zero_is_identity: bool = True) -> Pose:
    """Return a pose.

    zero_is_identity: take the zero quaternion, that of an unset message, for no rotation, as
        Gazebo does where it spawns a model or puts it somewhere.

    Raises:
        WorldError: naming `what` when the position is not finite or beyond FARTHEST, or the
            orientation is no unit quaternion.
    """
    p, q = message.position, message.orientation
    from_vector(p, f"{what}: position", FARTHEST)
    pose = (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)
    return check_pose(pose, what, WorldError, zero_is_identity)


def from_vector(
    message: Vector3 | Point, what: str, most: float = LARGEST
) -> tuple[float, float, float]:
    """Return (x, y, z); raises WorldError naming `what`: one is not finite or beyond `most`."""
    return check_bounds(
        check_vector((message.x, message.y, message.z), what, WorldError), what, most
    )


def check_bounds(values: tuple[float, ...], what: str, most: float = LARGEST) -> tuple[float, ...]:
    """Return the values; raises WorldError naming `what` when one is beyond `most` or NaN."""
    if not all(abs(value) <= most for value in values):
        raise WorldError(f"{what}: {values} is not finite or beyond ±{most:g}")
    return values


def from_twist(message: TwistMessage, what: str) -> Twist:
    """Return a twist; raises WorldError naming `what` when a number is not finite."""
    return Twist(
        from_vector(message.linear, f"{what}: linear velocity"),
        from_vector(message.angular, f"{what}: angular velocity"),
    )
