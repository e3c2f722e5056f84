"""Read and check the private parameters of the node."""

from __future__ import annotations

from pathlib import Path

import rospkg
import rospy

from aras_visual_servo_base.urdf import read_robot_name

from ..errors import ConfigurationError
from ..kinematics import Arm
from ..settings import ControllerSettings
from .reconfigure import NAMESPACE as GAINS


def read_node_settings() -> tuple[ControllerSettings, dict[str, object]]:
    """Return the settings of this node, and the parameters that the user has given.

    Raises:
        ConfigurationError: a parameter, the scheme, the law or the goal is wrong.
    """
    raw_settings = rospy.get_param("~", {})
    raw_settings.pop(GAINS[1:], None)
    raw_settings.setdefault("lockstep", rospy.get_param("/gazebo/speed_mode", "") == "lockstep")
    settings = ControllerSettings.from_mapping(raw_settings, find_package_folder())
    # construct the scheme only to report errors in its settings before a robot is available
    settings.list_cameras(settings.make_scheme())
    if settings.desired != "auto":
        settings.load_goal()
    return settings, raw_settings


def find_package_folder() -> Path:
    """Return the folder of this package."""
    return Path(rospkg.RosPack().get_path("aras_visual_servo_controller"))


def read_robot_settings(raw_settings: dict[str, object]) -> tuple[ControllerSettings, Arm]:
    """Return the settings for the robot on the parameter server, and its arm.

    Raises:
        ConfigurationError: there is no robot description, or the settings do not fit the robot.
    """
    settings = ControllerSettings.from_mapping(raw_settings, find_package_folder())
    urdf = str(rospy.get_param(settings.description, ""))
    if not urdf:
        raise ConfigurationError(
            f"there is no robot description on parameter {settings.description}: start the "
            "simulator, or load the URDF onto this parameter"
        )
    settings = settings.for_robot(read_robot_name(urdf), raw_settings)
    return settings, settings.make_arm(urdf)
