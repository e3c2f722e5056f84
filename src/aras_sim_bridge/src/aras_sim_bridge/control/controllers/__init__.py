"""The controllers of ros_control, without ROS; each is declared in a file here with `register`.

base.py describes how controllers are connected to ROS topics. registry.py describes how to add a
controller class of your own.
"""

from aras_sim_bridge.control.controllers.base import (
    ClaimedResources,
    Controller,
    ControllerContext,
    JointControllerState,
    JointStates,
)
from aras_sim_bridge.control.controllers.registry import ControllerTypes, register

__all__ = [
    "ClaimedResources",
    "ControllerContext",
    "Controller",
    "ControllerTypes",
    "JointControllerState",
    "JointStates",
    "register",
]
