"""Camera node and controller in one process, which saves memory and processor time.

They are one ROS node with the name and the parameters of the controller. The parameters of the
camera node are in the namespace aras_visual_servo_camera. The topics are the same as with two
nodes, but the controller gets the moments without a topic.
"""

from __future__ import annotations

import rospy

from aras_visual_servo_base.compiled import compile_all
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.node import make_node
from aras_visual_servo_ros.shutdown import node_main

from ..errors import ConfigurationError
from .controller_node import ControllerNode
from .node_settings import read_node_settings

CAMERA_PARAMETERS = "aras_visual_servo_camera"


def main() -> int:
    """Run both nodes and return the exit status, which is 1 if a parameter is wrong."""
    compile_all()
    faults = (ConfigurationError, VisionError)
    return node_main("aras_visual_servo_controller", __doc__, _run, faults)


def _run() -> None:
    controller = ControllerNode(*read_node_settings(), make_node(CAMERA_PARAMETERS))
    rospy.on_shutdown(controller.close)
    controller.spin()
