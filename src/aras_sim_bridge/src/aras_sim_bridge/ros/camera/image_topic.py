"""Publisher of sensor_msgs/Image that sends the pixels without copying them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from genpy import Time
from sensor_msgs.msg import Image

from aras_sim_bridge.ros.runtime.publisher import NonBlockingPublisher


class ImageTopic(NonBlockingPublisher):
    """Latched image publisher, like those of Gazebo; all calls must come from the same thread."""

    def __init__(self, topic: str, on_change: Callable[[], None]) -> None:
        """Advertise the topic.

        Any thread may call `on_change` when subscribers connect or leave.
        """
        super().__init__(topic, Image, queue_size=2, latch=True, on_change=on_change)

    def send(self, stamp: Time, frame_id: str, pixels: np.ndarray, encoding: str) -> None:
        """Publish an image; the pixels must not change afterwards.

        Args:
            stamp: time of the exposure.
            frame_id: optical frame of the camera.
            pixels: image (H, W) or (H, W, 3).
            encoding: ROS encoding of the pixels.
        """
        pixels = np.ascontiguousarray(pixels)
        message = Image(encoding=encoding, step=pixels.strides[0])
        message.header.stamp, message.header.frame_id = stamp, frame_id
        message.height, message.width = pixels.shape[:2]
        self.publish_array(message, pixels)
