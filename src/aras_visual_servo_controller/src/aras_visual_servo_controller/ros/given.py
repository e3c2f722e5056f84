"""The node's private parameters, checked before anything begins."""

from __future__ import annotations

from pathlib import Path

import rospkg
import rospy

from ..settings import Settings
from .reconfigure import NAMESPACE as GAINS


def given_settings() -> tuple[Settings, dict[str, object]]:
    """What the parameter server holds for this node, and the same as it was given.

    Raises:
        ConfigurationError: one line for a parameter, scheme, law or goal that cannot be.
    """
    package = Path(rospkg.RosPack().get_path("aras_visual_servo_controller"))
    given = rospy.get_param("~", {})
    given.pop(GAINS[1:], None)
    given.setdefault("lockstep", rospy.get_param("/gazebo/speed_mode", "") == "lockstep")
    settings = Settings.from_mapping(given, package)
    settings.make_scheme()  # what is wrong with it needs no robot to be told
    if settings.desired != "auto":
        settings.load_goal()
    return settings, given
