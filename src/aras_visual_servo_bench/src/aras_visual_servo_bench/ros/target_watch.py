"""Where the target lies, in a simulation or a replay, and what it looks like, for who draws it."""

from __future__ import annotations

import math
import time

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped

from aras_sim_bridge.errors import DescriptionError
from aras_sim_bridge.ros.conversions import from_pose

from ..drawing.outlines import NOTHING, Drawing, drawing_of
from ..drawing.story import Story
from .target_place import TARGET, TOPIC, TargetPlace

TARGET_DESCRIPTION = "/target_description"
PERIOD = 0.5  # s of wall time between two questions


class TargetWatch:
    """Draws the target where it lies; looks for it twice a second at most.

    Attributes:
        missing: why none is drawn, where the simulation has none; or ''.
    """

    def __init__(self) -> None:
        self.missing = ""
        self._asked = -math.inf
        self._known: tuple[str, Drawing] = ("", NOTHING)
        self._shapes = NOTHING.shapes(None)
        self._place = TargetPlace()
        self._told: PoseStamped | None = None  # by a recording, where no simulation runs
        rospy.Subscriber(TOPIC, PoseStamped, self._on_target, queue_size=1)

    def tell(self, story: Story, robot: str) -> None:
        """Give a story the target's shapes in the base of its robot, which the simulator calls so
        (in the world's frame where it does not); none where the arm carries the target."""
        if time.monotonic() - self._asked > PERIOD:
            pose = None if story.arm.target_frame else self._pose(robot)
            drawing = NOTHING if pose is None else self._drawing()
            self._shapes, self._asked = drawing.shapes(pose), time.monotonic()
        story.target = self._shapes

    def _drawing(self) -> Drawing:
        """What the target's description shows; nothing where there is none that can be drawn."""
        try:
            urdf = str(rospy.get_param(TARGET_DESCRIPTION, ""))
            if self._known[0] != urdf:
                self._known = urdf, drawing_of(urdf)
        except (OSError, DescriptionError):
            return NOTHING
        return self._known[1]

    def _pose(self, robot: str) -> np.ndarray | None:
        """(4, 4) base_T_target; None where nothing is known of it."""
        found = self._place.of(robot)
        none = self._place.answered and found is None
        self.missing = f"no model named {TARGET} is in the simulation" if none else ""
        if not self._place.answered:
            found = self._told
        if found is None:
            return None
        return from_pose(found.pose, "target").matrix()

    def _on_target(self, message: PoseStamped) -> None:
        self._told = message
