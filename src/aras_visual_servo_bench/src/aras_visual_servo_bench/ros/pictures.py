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
BUFFER = 2**24  # bytes, holds several images: always the newest, never a backlog
AS_FOUND = "green: the target as found \u2002 blue: as it is to be seen"
PLAIN = "the camera's picture: the camera node does not run"


class Pictures:
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
        self.note = PLAIN

    def watched(self, viewers: int) -> None:
        """Without a viewer nothing is subscribed to, and the camera node draws nothing."""
        with self._lock:
            if viewers and self._subscribers[0] is None:
                self._subscribe(0)
            elif not viewers:
                for which in (0, 1):
                    self._drop(which)
                self._newest = None

    def choose(self) -> None:
        """Take the plain picture where there is no other, and leave it where there is."""
        with self._lock:
            if self._subscribers[0] is None:
                return
            found = self._subscribers[0].get_num_connections() > 0
            self.note = AS_FOUND if found else PLAIN
            if found:
                self._drop(1)
            elif self._subscribers[1] is None:
                self._subscribe(1)

    def jpeg(self) -> bytes | None:
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

    def _hear(self, message: ImageMessage) -> None:
        self._newest = message

    def _subscribe(self, which: int) -> None:
        self._subscribers[which] = rospy.Subscriber(
            self._topics[which], ImageMessage, self._hear, queue_size=1, buff_size=BUFFER,
            tcp_nodelay=True,
        )  # fmt: skip

    def _drop(self, which: int) -> None:
        if self._subscribers[which] is not None:
            self._subscribers[which].unregister()
            self._subscribers[which] = None
