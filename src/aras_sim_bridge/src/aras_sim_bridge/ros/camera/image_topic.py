"""A topic of sensor_msgs/Image whose pixels go from their array into the listeners' sockets."""

from __future__ import annotations

import struct
from collections.abc import Callable
from io import BytesIO

import numpy as np
from genpy import Time
from sensor_msgs.msg import Image

from aras_sim_bridge.ros.runtime.publisher import QuickPublisher

_LENGTH = struct.Struct("<I")


class ImageTopic:
    """Latched, as Gazebo's; to be published on from one thread."""

    def __init__(self, topic: str, changed: Callable[[], None]) -> None:
        """Advertise; `changed` is called, from any thread, when listeners came or went."""
        self._publisher = QuickPublisher(topic, Image, queue_size=2, latch=True, changed=changed)

    def publish(self, stamp: Time, frame_id: str, pixels: np.ndarray, encoding: str) -> None:
        """Send pixels (H, W) or (H, W, 3) of ROS encoding `encoding`; they must not change after.

        frame_id: the camera's optical frame.
        """
        pixels = np.ascontiguousarray(pixels)
        head = Image(encoding=encoding, step=pixels.strides[0])
        head.header.seq = self._publisher.next_sequence()
        head.header.stamp, head.header.frame_id = stamp, frame_id
        head.height, head.width = pixels.shape[:2]
        buffer = BytesIO()
        head.serialize(buffer)
        # A message ends with its data, before which stands their length: 0 so far.
        body = buffer.getvalue()[: -_LENGTH.size] + _LENGTH.pack(pixels.nbytes)
        self._publisher.publish_bytes(body, memoryview(pixels).cast("B"))

    @property
    def listeners(self) -> int:
        """Number of listeners."""
        return self._publisher.listeners

    def unregister(self) -> None:
        """Take the topic off the graph."""
        self._publisher.unregister()
