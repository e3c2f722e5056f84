"""Between ROS messages and the plain data of the loop."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.moments import Moments

from .before.schemes.base import Measurement
from .before.servo import ServoCommand
from .kinematics import JOINT_NAMES

OPTICAL_FRAME = "camera_optical_frame"


def joint_positions(names: Sequence[str], positions: Sequence[float]) -> np.ndarray:
    """The six joints (6,) in the package's order, found by name.

    Raises:
        KeyError: with the names that are missing, as text.
        ValueError: as many positions as names are needed.
    """
    if len(names) != len(positions):
        raise ValueError(f"{len(names)} joint names but {len(positions)} positions")
    values = dict(zip(names, positions, strict=True))
    missing = [name for name in JOINT_NAMES if name not in values]
    if missing:
        raise KeyError(", ".join(missing))
    return np.array([values[name] for name in JOINT_NAMES], float)


def measurement(message: Any, kernel: Sequence[float] | None = None) -> Measurement:
    """From an ImageMoments message, and the 20 numbers of camera/data for a kernel scheme."""
    stamp = message.header.stamp.to_sec()
    valid, reason, moments = bool(message.valid), str(message.reason), None
    if valid and kernel is None:
        try:
            moments = Moments.from_arrays(message.m, message.mu, int(message.order))
        except VisionError as error:
            valid, reason = False, f"unusable moments: {error}"
    return Measurement(
        stamp=stamp,
        valid=valid,
        reason=reason,
        moments=moments,
        kernel=None if kernel is None else np.asarray(kernel, float),
        K=np.asarray(message.K, float).reshape(3, 3),
        width=int(message.width),
        height=int(message.height),
        pixel_count=int(message.pixel_count),
    )


def fill_state(message: Any, command: ServoCommand, scheme: str) -> Any:
    """Fill a ServoState message (all but the header's stamp) from a command; returns it."""
    message.header.frame_id = OPTICAL_FRAME
    message.scheme = scheme
    message.phase = command.phase
    message.reason = command.reason
    message.joint_names = list(JOINT_NAMES)
    result = command.scheme_result
    if result is not None:
        message.feature_names = list(result.names)
        message.features = result.features.tolist()
        message.desired_features = result.desired.tolist()
        message.error = result.error.tolist()
    fill_twist(message.camera_twist, command.twist)
    if command.joint_positions is not None:
        message.joint_positions = command.joint_positions.tolist()
    if command.joint_commands is not None:
        message.joint_commands = command.joint_commands.tolist()
    if command.resolution is not None:
        message.joint_velocities = command.resolution.joint_velocities.tolist()
        message.singular_values = command.resolution.singular_values.tolist()
    else:
        message.joint_velocities = [0.0] * len(JOINT_NAMES)
    return message


def fill_twist(message: Any, twist: np.ndarray) -> Any:
    """Fill a geometry_msgs/Twist from (6,); returns it."""
    message.linear.x, message.linear.y, message.linear.z = (float(v) for v in twist[:3])
    message.angular.x, message.angular.y, message.angular.z = (float(v) for v in twist[3:])
    return message
