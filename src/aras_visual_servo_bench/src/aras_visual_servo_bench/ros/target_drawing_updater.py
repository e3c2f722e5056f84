"""Pose and shape of the target for a drawing, from a simulation or from a replayed bag."""

from __future__ import annotations

import math
import time

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped

from aras_sim_bridge.errors import DescriptionError
from aras_sim_bridge.ros.conversions import from_pose

from ..visualization.model_drawing import EMPTY_DRAWING, ModelDrawing, draw_model
from ..visualization.run_drawing import RunDrawing
from .target_pose_reader import TARGET, TOPIC, TargetPoseReader

TARGET_DESCRIPTION = "/target_description"
PERIOD = 0.5  # shortest time between two queries of the target's pose, s of wall time


class TargetDrawingUpdater:
    """Updates the drawing of the target in a RunDrawing, which is the drawing of a run.

    Attributes:
        missing_reason: message if the simulation has no target, otherwise ''.
    """

    def __init__(self) -> None:
        self.missing_reason = ""
        self._update_time = -math.inf
        self._cached_drawing: tuple[str, ModelDrawing] = ("", EMPTY_DRAWING)
        self._shapes = EMPTY_DRAWING.make_shapes(None)
        self._pose_reader = TargetPoseReader()
        # pose from a played recording, used if there is no simulator
        self._recorded_pose: PoseStamped | None = None
        rospy.Subscriber(TOPIC, PoseStamped, self._on_target, queue_size=1)

    def update(self, run_trace: RunDrawing, robot: str) -> None:
        """Set the drawing of the target in a RunDrawing; query its pose at most once per PERIOD.

        The drawing is in the base frame of the robot, or in the world frame if the simulator has no
        model `robot`. A target that the arm carries is not drawn.
        """
        if time.monotonic() - self._update_time > PERIOD:
            pose = None if run_trace.arm.target_frame else self._find_pose(robot)
            drawing = EMPTY_DRAWING if pose is None else self._read_drawing()
            self._shapes, self._update_time = drawing.make_shapes(pose), time.monotonic()
        run_trace.target = self._shapes

    def _read_drawing(self) -> ModelDrawing:
        """Return the drawing of the target; it is empty if the target has no valid description."""
        try:
            urdf = str(rospy.get_param(TARGET_DESCRIPTION, ""))
            if self._cached_drawing[0] != urdf:
                self._cached_drawing = urdf, draw_model(urdf)
        except (OSError, DescriptionError):
            return EMPTY_DRAWING
        return self._cached_drawing[1]

    def _find_pose(self, robot: str) -> np.ndarray | None:
        """Return the pose base_T_target (4, 4); return None if it is unknown."""
        found = self._pose_reader.read_pose(robot)
        is_missing = self._pose_reader.has_simulator and found is None
        self.missing_reason = (
            f"the simulation has no model named {TARGET}" if is_missing else ""
        )
        if not self._pose_reader.has_simulator:
            found = self._recorded_pose
        if found is None:
            return None
        return from_pose(found.pose, "target").matrix()

    def _on_target(self, message: PoseStamped) -> None:
        self._recorded_pose = message
