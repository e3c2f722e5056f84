"""The picture of a graph's camera, as JPEG, while somebody looks."""

from __future__ import annotations

import threading

import cv2
import numpy as np
import rospy
from sensor_msgs.msg import Image as ImageMessage

from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.images import decode

QUALITY = 80
BUFFER_BYTES = 2**24  # bytes, holds several images: always the newest, never a backlog
OVERLAY_NOTE = "green: the target as found \u2002 blue: as it is to be seen"
PLAIN_NOTE = "the camera's picture: the camera node does not run"


class ImageSubscriber:
    """What the camera node saw and found; where it does not run, what the camera saw.

    Attributes:
        note: what the picture shows.
    """

    def __init__(self, space: str, camera: str) -> None:
        """Namespaces of the camera node's topics and of the camera's."""
        self._topics = f"{space}/camera/overlay", f"{camera}/image_raw"
        self._subscribers: list[rospy.Subscriber | None] = [None, None]
        self._lock = threading.Lock()
        self._newest: ImageMessage | None = None
        self.note = PLAIN_NOTE

    def set_viewer_count(self, viewers: int) -> None:
        """Without a viewer nothing is subscribed to, and the camera node draws nothing."""
        with self._lock:
            if viewers and self._subscribers[0] is None:
                self._subscribe(0)
            elif not viewers:
                for which in (0, 1):
                    self._unsubscribe(which)
                self._newest = None

    def choose_topic(self) -> None:
        """Take the plain picture where there is no other, and leave it where there is."""
        with self._lock:
            if self._subscribers[0] is None:
                return
            found = self._subscribers[0].get_num_connections() > 0
            self.note = OVERLAY_NOTE if found else PLAIN_NOTE
            if found:
                self._unsubscribe(1)
            elif self._subscribers[1] is None:
                self._subscribe(1)

    def take_jpeg(self) -> bytes | None:
        """The newest picture; None where none came since the last call."""
        message, self._newest = self._newest, None
        if message is None:
            return None
        try:
            bgr = np.ascontiguousarray(decode(message).rgb[:, :, ::-1])
        except VisionError:
            return None  # the camera node says what is wrong with it
        done, content = cv2.imencode(".jpg", bgr, (cv2.IMWRITE_JPEG_QUALITY, QUALITY))
        return content.tobytes() if done else None

    def _on_image(self, message: ImageMessage) -> None:
        self._newest = message

    def _subscribe(self, index: int) -> None:
        self._subscribers[index] = rospy.Subscriber(
            self._topics[index], ImageMessage, self._on_image, queue_size=1, buff_size=BUFFER_BYTES,
            tcp_nodelay=True,
        )  # fmt: skip

    def _unsubscribe(self, index: int) -> None:
        if self._subscribers[index] is not None:
            self._subscribers[index].unregister()
            self._subscribers[index] = None
