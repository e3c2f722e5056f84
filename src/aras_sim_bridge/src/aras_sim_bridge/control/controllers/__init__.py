"""ros_control's controllers, without ROS; the registry imports one when its type is asked for.

base.py documents the ports a ROS skin attaches to, registry.py how a class of your own is found.
"""

from aras_sim_bridge.control.controllers.base import (
    ClaimedResources,
    Context,
    Controller,
    JointControllerState,
    JointStates,
)
from aras_sim_bridge.control.controllers.registry import Registry, register

__all__ = [
    "ClaimedResources",
    "Context",
    "Controller",
    "JointControllerState",
    "JointStates",
    "Registry",
    "register",
]
