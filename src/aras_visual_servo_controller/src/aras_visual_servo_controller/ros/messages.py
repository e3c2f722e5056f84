"""Conversion between ROS messages and the data of the loop."""

from __future__ import annotations

import numpy as np
from aras_visual_servo_camera.msg import ImageMoments
from geometry_msgs.msg import Twist

from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.moments import Moments

from ..msg import ServoReport, ServoState
from ..records.outcomes import PoseUncertainty
from ..records.state import ServoState as State

# Placeholder for an image without valid intrinsics; no computation uses it.
UNKNOWN_CAMERA = CameraModel(1, 1, tuple(np.eye(3).flat))


def read_camera(message: ImageMoments) -> tuple[CameraModel, str]:
    """Return the camera of a message, and what is wrong with its intrinsics ('' if nothing is)."""
    try:
        return CameraModel.from_message(message), ""
    except VisionError as error:
        return UNKNOWN_CAMERA, str(error)


def read_moments(message: ImageMoments) -> tuple[Moments | None, str]:
    """Return the moments of a message, or the reason why there are none."""
    if not message.valid:
        return None, message.reason or "the target is not visible"
    try:
        return Moments.from_arrays(message.m, message.mu, int(message.order)), ""
    except (VisionError, ValueError, OverflowError) as error:
        return None, f"unusable moments: {error}"


def make_state_message(state: State, scheme: str, frame: str, names: tuple[str, ...]) -> ServoState:
    """Convert the state of one image to a ServoState message, in which the caller sets the stamp.
    """
    message = ServoState(scheme=scheme, phase=state.phase, reason=state.reason)
    message.header.frame_id = frame
    message.joint_names = list(names)
    output, solution = state.scheme_output, state.ik_solution
    if output is not None:
        message.feature_names = list(output.names)
        message.features = np.asarray(output.features).tolist()
        message.desired_features = np.asarray(output.desired).tolist()
        message.error = np.asarray(output.error).tolist()
    message.camera_twist = make_twist_message(state.desired_twist)
    if state.joints is not None:
        message.joint_positions = state.joints.positions.tolist()
    if state.command is not None:
        message.joint_commands = state.command.tolist()
    message.joint_velocities = [0.0] * len(names)
    if solution is not None:
        message.joint_velocities = solution.velocities.tolist()
        message.singular_values = solution.singular_values.tolist()
    return message


def make_report_message(state: State, frame: str, names: tuple[str, ...]) -> ServoReport:
    """Convert the state of the loop to a ServoReport message; the caller sets its stamp."""
    message = ServoReport(
        phase=state.phase, outcome=state.outcome, reason=state.reason, remedy=state.remedy
    )
    message.header.frame_id = frame
    message.joint_names = list(names)
    message.desired_twist = make_twist_message(state.desired_twist)
    message.achieved_twist = make_twist_message(state.achieved_twist)
    message.rank, message.singular_values_l = int(state.rank), list(state.singular_values_L)
    message.scale, message.computation_time = 1.0, state.computation_time
    uncertainty = state.arrival_status.pose_uncertainty or PoseUncertainty()
    message.open_distance, message.open_angle = uncertainty.distance, uncertainty.angle
    if state.scheme_output is not None and state.scheme_output.filtered_error is not None:
        message.filtered_error = np.asarray(state.scheme_output.filtered_error).tolist()
    solution = state.ik_solution
    if solution is not None:
        message.infeasible_twist = make_twist_message(solution.infeasible_twist)
        message.rank_lj = solution.rank
        message.singular_values_lj = solution.singular_values.tolist()
        message.null_direction = solution.null_direction.tolist()
        message.manipulability = solution.manipulability
        message.margins = solution.margins.tolist()
        message.scale = solution.scale
    return message


def make_twist_message(twist: np.ndarray) -> Twist:
    """Convert a twist (6,) to geometry_msgs/Twist."""
    message = Twist()
    values = [float(v) for v in twist]
    message.linear.x, message.linear.y, message.linear.z = values[:3]
    message.angular.x, message.angular.y, message.angular.z = values[3:]
    return message
