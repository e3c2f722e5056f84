"""Visual servo controller node."""

from __future__ import annotations

import rospy

from aras_visual_servo_base.compiled import compile_all
from aras_visual_servo_ros.shutdown import node_main

from ..errors import ConfigurationError
from .controller_node import ControllerNode
from .node_settings import read_node_settings


def main() -> int:
    """Run the node and return its exit status."""
    compile_all()
    return node_main("aras_visual_servo_controller", __doc__, _run, ConfigurationError)


def _run() -> None:
    node = ControllerNode(*read_node_settings())
    rospy.on_shutdown(node.close)
    node.spin()
