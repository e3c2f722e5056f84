"""ROS node of the camera: measures the target in each image and publishes the result."""

from __future__ import annotations

import rospy

from aras_visual_servo_base.compiled import compile_all
from aras_visual_servo_ros.shutdown import node_main

from .camera_node import CameraNode
from .errors import VisionError
from .parameters import VisionParameters


def make_node(namespace: str = "~") -> CameraNode:
    """Create a node with the parameters in a namespace.

    Raises:
        VisionError: a parameter is wrong.
    """
    parameters = rospy.get_param(namespace, {})
    node = CameraNode(
        VisionParameters.from_mapping(parameters if isinstance(parameters, dict) else {})
    )
    rospy.loginfo("camera node ready, layout '%s'", node.parameters.pipeline_settings.layout)
    return node


def main() -> int:
    """Run the node and return its exit status, which is 1 if a parameter is wrong."""
    compile_all()
    # The node needs no simulated time. Receiving /clock would take a third of its processor time.
    return node_main("aras_visual_servo_camera", __doc__, lambda: make_node().spin(), VisionError,
                     disable_rostime=True)  # fmt: skip
