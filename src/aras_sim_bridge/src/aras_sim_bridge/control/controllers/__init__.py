"""The controllers of ros_control, without ROS; each is declared in a file here with `register`.

base.py documents the ports that the ROS layer connects to topics, and registry.py how the
controller manager finds a controller class of a user.
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
