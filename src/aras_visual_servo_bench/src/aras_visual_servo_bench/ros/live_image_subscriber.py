"""Subscriber of the camera's images, which are converted to JPEG for the live page."""

from __future__ import annotations

import threading

import cv2
import numpy as np
import rospy
from sensor_msgs.msg import Image as ImageMessage

from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.images import decode

QUALITY = 80
# Size of a subscriber's receive buffer, bytes. rospy drops old images only if its buffer holds
# several images. With a smaller buffer, old images would wait in the socket, and the page would
# show them late.
BUFFER_BYTES = 2**24
OVERLAY_NOTE = "green: detected target \u2002 blue: desired view"
PLAIN_NOTE = "camera image; the camera node is not running"


class LiveImageSubscriber:
    """Subscriber of the camera node's overlay: the camera image with the features drawn into it.

    If the camera node is not running, the raw image of the camera is used.

    Attributes:
        note: explanation of the image, shown on the page.
    """

    def __init__(self, space: str, camera: str) -> None:
        """Create a subscriber.

        Args:
            space: namespace of the camera node's topics.
            camera: namespace of the camera's topics.
        """
        self._topics = f"{space}/camera/overlay", f"{camera}/image_raw"
        self._subscribers: list[rospy.Subscriber | None] = [None, None]
        self._lock = threading.Lock()
        self._newest: ImageMessage | None = None
        self.note = PLAIN_NOTE

    def set_viewer_count(self, viewers: int) -> None:
        """Subscribe to the images if the page has viewers, unsubscribe if it has none.

        The camera node draws its overlay only if this image has a subscriber.
        """
        with self._lock:
            if viewers and self._subscribers[0] is None:
                self._subscribe(0)
            elif not viewers:
                for which in (0, 1):
                    self._unsubscribe(which)
                self._newest = None

    def choose_topic(self) -> None:
        """Use the camera node's overlay if a node publishes it, otherwise the camera's raw image.
        """
        with self._lock:
            if self._subscribers[0] is None:
                return
            has_overlay = self._subscribers[0].get_num_connections() > 0
            if has_overlay:
                self._unsubscribe(1)
            elif self._subscribers[1] is None:
                self._subscribe(1)
            has_image = has_overlay or self._subscribers[1].get_num_connections() > 0
            self.note = (
                OVERLAY_NOTE if has_overlay
                else PLAIN_NOTE if has_image
                else f"no image: no node publishes {' or '.join(self._topics)}"
            )  # fmt: skip

    def take_jpeg(self) -> bytes | None:
        """Return the newest image as JPEG; return None if it was returned before."""
        message, self._newest = self._newest, None
        if message is None:
            return None
        try:
            bgr = np.ascontiguousarray(decode(message).rgb[:, :, ::-1])
        except VisionError:
            # Not an error of this page: the camera node reports an image that cannot be decoded.
            return None
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
