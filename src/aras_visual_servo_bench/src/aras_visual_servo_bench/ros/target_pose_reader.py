"""Where a graph's target lies."""

from __future__ import annotations

import rospy
from gazebo_msgs.srv import GetModelState, GetWorldProperties
from geometry_msgs.msg import Pose, PoseStamped

TARGET = "target"  # the name under which a target is spawned, as the launch files have it
STATE, WORLD = "/gazebo/get_model_state", "/gazebo/get_world_properties"
TOPIC = "/aras_visual_servo/target"  # what a recorder is told of it, latched
MIN_MOTION = 1e-5  # m, or of a quaternion


class TargetPoseReader:
    """Asks the simulator for the target.

    Attributes:
        answered: whether there was a simulator at the last question.
    """

    def __init__(self) -> None:
        self.has_simulator = False
        self._models = rospy.ServiceProxy(WORLD, GetWorldProperties)
        self._state = rospy.ServiceProxy(STATE, GetModelState)

    def read_pose(self, robot: str) -> PoseStamped | None:
        """The target in the base of a robot, or in the world where there is none of that name; None
        without a simulation, as in a replay, or without a target.

        Only models that are there are asked for: of every other the simulator logs an error.
        """
        self.has_simulator = False
        try:
            models = self._models().model_names
            if TARGET not in models:
                self.has_simulator = True
                return None
            state = self._state(TARGET, robot if robot in models else "")
        except (rospy.ROSException, rospy.ServiceException, OSError):
            return None
        self.has_simulator = True
        return PoseStamped(state.header, state.pose) if state.success else None


def has_moved(before: Pose | None, after: Pose) -> bool:
    """Whether a model lies elsewhere than before."""
    return before is None or any(
        abs(getattr(getattr(after, part), key) - getattr(getattr(before, part), key)) > MIN_MOTION
        for part, keys in (("position", "xyz"), ("orientation", "xyzw")) for key in keys
    )
