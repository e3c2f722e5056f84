"""ros_control's controllers, without ROS; importing this package registers them all."""

from aras_sim_bridge.controllers import effort, joint_state
from aras_sim_bridge.controllers.base import (
    ClaimedResources,
    Context,
    Controller,
    JointControllerState,
    JointStates,
)
from aras_sim_bridge.controllers.registry import Registry, register

__all__ = [
    "ClaimedResources",
    "Context",
    "Controller",
    "JointControllerState",
    "JointStates",
    "Registry",
    "effort",
    "joint_state",
    "register",
]
