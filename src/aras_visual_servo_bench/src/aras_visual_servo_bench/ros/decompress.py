"""Node that decompresses the images of a bag for rviz and the camera node."""

from __future__ import annotations

import cv2
import numpy as np
import rospy
from sensor_msgs.msg import CompressedImage, Image

from aras_visual_servo_camera.messages import make_image_message
from aras_visual_servo_ros.shutdown import init_node


def decompress(message: CompressedImage) -> Image | None:
    """Convert a compressed image to an rgb8 or mono8 image; return None if this fails."""
    image = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.dtype != np.uint8:
        return None
    encoding = "mono8" if image.ndim == 2 else "rgb8"
    if encoding == "rgb8":
        image = cv2.cvtColor(image[..., :3], cv2.COLOR_BGR2RGB)
    return make_image_message(image, encoding, message.header)


def main() -> int:
    """Run the node and return its exit status.

    It subscribes to CAMERA/image_raw/compressed and publishes CAMERA/image_raw, where CAMERA is the
    parameter ~camera.
    """
    init_node("decompress", __doc__)
    topic = rospy.get_param("~camera", "/labrob/camera").rstrip("/") + "/image_raw"
    publisher = rospy.Publisher(topic, Image, queue_size=2)

    def publish(message: CompressedImage) -> None:
        image = decompress(message)
        if image is None:
            rospy.logwarn_throttle(
                5.0, f"{topic}/compressed: cannot decode an image ({message.format})"
            )
        elif not rospy.is_shutdown():
            publisher.publish(image)

    rospy.Subscriber(f"{topic}/compressed", CompressedImage, publish, queue_size=2)
    rospy.spin()
    return 0
