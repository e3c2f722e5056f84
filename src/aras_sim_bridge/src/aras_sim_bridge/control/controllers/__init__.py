"""ros_control's controllers, without ROS. One file of this folder declares each with `register`.

base.py documents the ports a ROS skin attaches to, registry.py how a class of your own is found.
"""

from aras_sim_bridge.control.controllers.base import (
    ClaimedResources,
    Context,
    Controller,
    JointControllerState,
    JointStates,
)
from aras_sim_bridge.control.controllers.registry import ControllerTypes, register

__all__ = [
    "ClaimedResources",
    "Context",
    "Controller",
    "ControllerTypes",
    "JointControllerState",
    "JointStates",
    "register",
]
