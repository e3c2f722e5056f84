"""Reading of the target's pose from the simulator."""

from __future__ import annotations

import rospy
from gazebo_msgs.srv import GetModelState, GetWorldProperties
from geometry_msgs.msg import Pose, PoseStamped

TARGET = "target"  # model name of the target in the launch files
STATE, WORLD = "/gazebo/get_model_state", "/gazebo/get_world_properties"
TOPIC = "/aras_visual_servo/target"  # latched pose of the target, for recorders
MIN_MOTION = 1e-5  # m, or change of a quaternion component


class TargetPoseReader:
    """Reader of the target's pose by the simulator's services.

    Attributes:
        has_simulator: whether a simulator answered the last query.
    """

    def __init__(self) -> None:
        self.has_simulator = False
        self._models = rospy.ServiceProxy(WORLD, GetWorldProperties)
        self._state = rospy.ServiceProxy(STATE, GetModelState)

    def read_pose(self, robot: str) -> PoseStamped | None:
        """Return the target's pose in the base frame of a robot, or None.

        The pose is in the world frame if there is no such robot. It is None without a target, and
        without a simulator, as in a replay. Only existing models are queried, because the
        simulator logs an error for any other.
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
    """Return whether a model has moved by more than MIN_MOTION; true without a previous pose."""
    return before is None or any(
        abs(getattr(getattr(after, part), key) - getattr(getattr(before, part), key)) > MIN_MOTION
        for part, keys in (("position", "xyz"), ("orientation", "xyzw")) for key in keys
    )
