"""ros_control's controllers, without ROS; importing this package registers them all.

base.py documents the ports a ROS skin attaches to, registry.py how a class of your own is found.
"""

from aras_sim_bridge.control.controllers import (
    forward,
    gripper,
    joint_state,
    pid_controllers,
    trajectory,
)
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
    "forward",
    "gripper",
    "joint_state",
    "pid_controllers",
    "register",
    "trajectory",
]
