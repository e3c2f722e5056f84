"""Reader of the target's pose in the simulator."""

from __future__ import annotations

import rospy
from gazebo_msgs.srv import GetModelState, GetWorldProperties
from geometry_msgs.msg import Pose, PoseStamped

TARGET = "target"  # name of the target's model in the launch files
STATE, WORLD = "/gazebo/get_model_state", "/gazebo/get_world_properties"
# latched topic with the target's pose, so that a recording contains the pose
TOPIC = "/aras_visual_servo/target"
# Smallest change of a coordinate (m) or quaternion component that counts as motion of the target.
MIN_MOTION = 1e-5


class TargetPoseReader:
    """Reads the target's pose by calling the simulator's services.

    Attributes:
        has_simulator: True if a simulator has answered the last query.
    """

    def __init__(self) -> None:
        self.has_simulator = False
        self._models = rospy.ServiceProxy(WORLD, GetWorldProperties)
        self._state = rospy.ServiceProxy(STATE, GetModelState)

    def read_pose(self, robot: str) -> PoseStamped | None:
        """Return the target's pose in the base frame of a robot.

        The pose is in the world frame if there is no such robot. Return None if there is no target,
        or no simulator, as during a replay. Only existing models are queried, because the simulator
        logs an error for a model that does not exist.
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
    """Return whether two poses differ by more than MIN_MOTION; True if `before` is None."""
    return before is None or any(
        abs(getattr(getattr(after, part), key) - getattr(getattr(before, part), key)) > MIN_MOTION
        for part, keys in (("position", "xyz"), ("orientation", "xyzw")) for key in keys
    )
