"""Where a graph's target lies."""

from __future__ import annotations

import rospy
from gazebo_msgs.srv import GetModelState, GetWorldProperties
from geometry_msgs.msg import Pose, PoseStamped

TARGET = "target"  # the name under which a target is spawned, as the launch files have it
STATE, WORLD = "/gazebo/get_model_state", "/gazebo/get_world_properties"
TOPIC = "/aras_visual_servo/target"  # what a recorder is told of it, latched
MOVED = 1e-5  # m, or of a quaternion


class TargetPlace:
    """Asks the simulator for the target.

    Attributes:
        answered: whether there was a simulator at the last question.
    """

    def __init__(self) -> None:
        self.answered = False
        self._models = rospy.ServiceProxy(WORLD, GetWorldProperties)
        self._state = rospy.ServiceProxy(STATE, GetModelState)

    def of(self, robot: str) -> PoseStamped | None:
        """The target in the base of a robot, or in the world where there is none of that name; None
        without a simulation, as in a replay, or without a target.

        Only models that are there are asked for: of every other the simulator logs an error.
        """
        self.answered = False
        try:
            models = self._models().model_names
            if TARGET not in models:
                self.answered = True
                return None
            state = self._state(TARGET, robot if robot in models else "")
        except (rospy.ROSException, rospy.ServiceException, OSError):
            return None
        self.answered = True
        return PoseStamped(state.header, state.pose) if state.success else None


def moved(before: Pose | None, now: Pose) -> bool:
    """Whether a model lies elsewhere than before."""
    return before is None or any(
        abs(getattr(getattr(now, part), key) - getattr(getattr(before, part), key)) > MOVED
        for part, keys in (("position", "xyz"), ("orientation", "xyzw")) for key in keys
    )
