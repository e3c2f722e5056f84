"""Conversion of recorded messages to states of the loop.

The messages may be of this version or of an older one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..kinematics.ik_solution import IKSolution
from ..kinematics.joint_sample import JointSample
from ..records.outcomes import NOT_ARRIVED, ArrivalStatus, PoseUncertainty
from ..records.state import ServoState as State
from ..schemes.base import SchemeOutput

if TYPE_CHECKING:
    from geometry_msgs.msg import Twist

    from ..msg import ServoReport, ServoState


def read_state(message: ServoState, report: ServoReport | None = None) -> State:
    """Convert a ServoState message and the ServoReport of the same image to a state.

    Without a report, the values that only the report contains are NaN. The scheme output has no
    task, and the IK solution has neither L nor Jacobian.
    """
    stamp, names = message.header.stamp.to_sec(), tuple(message.joint_names)
    output = solution = joints = None
    count = len(message.feature_names)
    if count and all(len(values) == count for values in (
        message.features, message.desired_features, message.error
    )):  # fmt: skip
        filtered = getattr(report, "filtered_error", ())
        output = SchemeOutput(
            tuple(message.feature_names), np.array(message.features),
            np.array(message.desired_features), np.array(message.error),
            filtered_error=np.array(filtered) if len(filtered) == count else None,
        )  # fmt: skip
    if output is not None and len(message.singular_values):
        solution = IKSolution.from_record(
            np.array(message.joint_velocities), read_twist(message.camera_twist),
            np.full(6, np.nan) if report is None else read_twist(report.achieved_twist),
            (np.array([] if report is None else report.singular_values_l),
             np.array(message.singular_values)),
            np.nan if report is None else report.scale,
        )  # fmt: skip
    if len(message.joint_positions) == len(names):
        joints = JointSample.from_values(stamp, names, message.joint_positions)
    uncertainty = PoseUncertainty(
        *(getattr(report, f"open_{kind}", np.nan) for kind in ("distance", "angle"))
    )
    commanded = len(message.joint_commands) == len(names)
    return State(
        stamp, message.phase, "" if report is None else report.outcome, message.reason,
        "" if report is None else report.remedy, output, solution, joints,
        np.array(message.joint_commands) if commanded else None,
        np.nan if report is None else report.computation_time, scheme=message.scheme,
        arrival_status=NOT_ARRIVED if np.isnan([uncertainty.distance, uncertainty.angle]).all() else
        ArrivalStatus(True, pose_uncertainty=uncertainty),
    )  # fmt: skip


def read_twist(message: Twist) -> np.ndarray:
    """Convert a geometry_msgs/Twist to an array (6,)."""
    return np.array([getattr(part, axis) for part in (message.linear, message.angular)
                     for axis in "xyz"])  # fmt: skip
