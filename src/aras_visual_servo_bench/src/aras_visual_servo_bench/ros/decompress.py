"""Compressed pictures of a bag as raw ones, for rviz and the camera node, which know no others."""

from __future__ import annotations

import cv2
import numpy as np
import rospy
from sensor_msgs.msg import CompressedImage, Image

from aras_visual_servo_camera.messages import make_image_message
from aras_visual_servo_ros.shutdown import init_node


def decompress(message: CompressedImage) -> Image | None:
    """The picture with its stamp and frame, rgb8 or mono8; None where it cannot be read."""
    picture = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None or picture.dtype != np.uint8:
        return None
    encoding = "mono8" if picture.ndim == 2 else "rgb8"
    if encoding == "rgb8":
        picture = cv2.cvtColor(picture[..., :3], cv2.COLOR_BGR2RGB)
    return make_image_message(picture, encoding, message.header)


def main() -> int:
    """The node `decompress`: from ~camera/image_raw/compressed to ~camera/image_raw."""
    init_node("decompress", __doc__)
    topic = rospy.get_param("~camera", "/labrob/camera").rstrip("/") + "/image_raw"
    publisher = rospy.Publisher(topic, Image, queue_size=2)

    def publish(message: CompressedImage) -> None:
        picture = decompress(message)
        if picture is None:
            rospy.logwarn_throttle(
                5.0, f"{topic}/compressed: a picture ({message.format}) cannot be read"
            )
        elif not rospy.is_shutdown():
            publisher.publish(picture)

    rospy.Subscriber(f"{topic}/compressed", CompressedImage, publish, queue_size=2)
    rospy.spin()
    return 0
