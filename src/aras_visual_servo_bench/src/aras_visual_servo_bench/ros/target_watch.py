"""Where the target of a running simulation lies, and what it looks like, for who draws it."""

from __future__ import annotations

import time

import numpy as np
import rospy
from gazebo_msgs.srv import GetModelState

from aras_sim_bridge.errors import DescriptionError
from aras_sim_bridge.poses import Pose

from ..live.outlines import edges_of
from ..live.shapes import LINES, Shape, carried
from ..live.story import Story

TARGET = "target"  # the name under which a target is spawned, as the launch files have it
TARGET_DESCRIPTION = "/target_description"
STATE = "/gazebo/get_model_state"
PERIOD = 0.5  # s of wall time between two questions
COLOUR = (0.08, 0.08, 0.1, 1.0)
NOTHING = np.zeros((0, 3))


class TargetWatch:
    """Asks the simulator for the target, twice a second at most, and draws its edges."""

    def __init__(self) -> None:
        self._asked = -1e9
        self._known: tuple[str, np.ndarray] = ("", NOTHING)
        self._points = NOTHING
        self._ask = rospy.ServiceProxy(STATE, GetModelState)

    def tell(self, story: Story, robot: str) -> None:
        """Give a story the target's edges in the base of its robot, which the simulator calls so
        (in the world's frame where it does not); none where the arm carries the target."""
        if time.monotonic() - self._asked > PERIOD:
            self._points = NOTHING if story.arm.target_frame else self._seen(robot)
            self._asked = time.monotonic()
        story.target = Shape("target", LINES, self._points, COLOUR, 0.002)

    def _seen(self, robot: str) -> np.ndarray:
        try:
            urdf = rospy.get_param(TARGET_DESCRIPTION, "")
            if not isinstance(urdf, str) or not urdf:
                return NOTHING
            if self._known[0] != urdf:
                self._known = urdf, edges_of(urdf)
            state = self._ask(TARGET, robot)
            if not state.success:
                state = self._ask(TARGET, "")
        except (rospy.ROSException, rospy.ServiceException, OSError, DescriptionError):
            return NOTHING  # no simulation, as in a replay, or nothing that can be drawn
        if not state.success:
            return NOTHING
        place, turn = state.pose.position, state.pose.orientation
        pose = Pose((place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w))
        return carried(np.array(pose.matrix()), self._known[1])
