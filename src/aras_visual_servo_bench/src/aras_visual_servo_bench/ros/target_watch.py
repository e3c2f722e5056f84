"""Where the target lies, in a simulation or a replay, and what it looks like, for who draws it."""

from __future__ import annotations

import math
import time

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped

from aras_sim_bridge.errors import DescriptionError
from aras_sim_bridge.ros.conversions import from_pose

from ..drawing.model_drawing import EMPTY_DRAWING, ModelDrawing, draw_model
from ..drawing.run_trace import RunTrace
from .target_pose_reader import TARGET, TOPIC, TargetPoseReader

TARGET_DESCRIPTION = "/target_description"
PERIOD = 0.5  # s of wall time between two questions


class TargetWatch:
    """Draws the target where it lies; looks for it twice a second at most.

    Attributes:
        missing: why none is drawn, where the simulation has none; or ''.
    """

    def __init__(self) -> None:
        self.missing_reason = ""
        self._update_time = -math.inf
        self._cached_drawing: tuple[str, ModelDrawing] = ("", EMPTY_DRAWING)
        self._shapes = EMPTY_DRAWING.make_shapes(None)
        self._pose_reader = TargetPoseReader()
        self._recorded_pose: PoseStamped | None = None  # by a recording, where no simulation runs
        rospy.Subscriber(TOPIC, PoseStamped, self._on_target, queue_size=1)

    def update(self, run_trace: RunTrace, robot: str) -> None:
        """Give a story the target's shapes in the base of its robot, which the simulator calls so
        (in the world's frame where it does not); none where the arm carries the target."""
        if time.monotonic() - self._update_time > PERIOD:
            pose = None if run_trace.arm.target_frame else self._find_pose(robot)
            drawing = EMPTY_DRAWING if pose is None else self._read_drawing()
            self._shapes, self._update_time = drawing.make_shapes(pose), time.monotonic()
        run_trace.target = self._shapes

    def _read_drawing(self) -> ModelDrawing:
        """What the target's description shows; nothing where there is none that can be drawn."""
        try:
            urdf = str(rospy.get_param(TARGET_DESCRIPTION, ""))
            if self._cached_drawing[0] != urdf:
                self._cached_drawing = urdf, draw_model(urdf)
        except (OSError, DescriptionError):
            return EMPTY_DRAWING
        return self._cached_drawing[1]

    def _find_pose(self, robot: str) -> np.ndarray | None:
        """(4, 4) base_T_target; None where nothing is known of it."""
        found = self._pose_reader.read_pose(robot)
        none = self._pose_reader.has_simulator and found is None
        self.missing_reason = f"no model named {TARGET} is in the simulation" if none else ""
        if not self._pose_reader.has_simulator:
            found = self._recorded_pose
        if found is None:
            return None
        return from_pose(found.pose, "target").matrix()

    def _on_target(self, message: PoseStamped) -> None:
        self._recorded_pose = message
