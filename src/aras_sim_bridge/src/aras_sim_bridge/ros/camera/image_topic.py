"""A topic of sensor_msgs/Image whose pixels go from their array into the listeners' sockets."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from genpy import Time
from sensor_msgs.msg import Image

from aras_sim_bridge.ros.runtime.publisher import NonBlockingPublisher


class ImageTopic(NonBlockingPublisher):
    """Latched, as Gazebo's; to be published on from one thread."""

    def __init__(self, topic: str, on_change: Callable[[], None]) -> None:
        """Advertise; `on_change` is called, from any thread, when listeners came or went."""
        super().__init__(topic, Image, queue_size=2, latch=True, on_change=on_change)

    def send(self, stamp: Time, frame_id: str, pixels: np.ndarray, encoding: str) -> None:
        """Send pixels (H, W) or (H, W, 3) of ROS encoding `encoding`; they must not change after.

        frame_id: the camera's optical frame.
        """
        pixels = np.ascontiguousarray(pixels)
        message = Image(encoding=encoding, step=pixels.strides[0])
        message.header.stamp, message.header.frame_id = stamp, frame_id
        message.height, message.width = pixels.shape[:2]
        self.publish_array(message, pixels)
