"""image_raw/compressed: what image_transport's compressed plugin publishes, settings included."""

from __future__ import annotations

import queue
import threading
from typing import Any

import cv2
import numpy as np
import rospy
from genpy import Time
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import Header

from aras_sim_bridge.errors import CameraError, SimError
from aras_sim_bridge.ros.camera.quick_publisher import listeners
from aras_sim_bridge.ros.control.reconfigure import Field, ReconfigureServer

# Names, defaults and limits are compressed_image_transport's.
COMPRESSED_FIELDS = (
    Field("format", "str", "jpeg", "", "", "Compression format: jpeg or png"),
    Field("jpeg_quality", "int", 80, 1, 100, "JPEG quality percentile"),
    Field("jpeg_progressive", "bool", False, False, True, "Progressive compression for JPEG"),
    Field("jpeg_optimize", "bool", False, False, True, "Optimised Huffman tables for JPEG"),
    Field("jpeg_restart_interval", "int", 0, 0, 65535, "Restart interval for JPEG"),
    Field("png_level", "int", 9, 1, 9, "PNG compression level"),
)
_COLOUR = {"rgb8": cv2.COLOR_RGB2BGR, "rgb16": cv2.COLOR_RGB2BGR, "bgr8": None}


def encode(image: np.ndarray, encoding: str, settings: dict[str, Any]) -> tuple[str, bytes]:
    """Return image_transport's format text and the file's bytes.

    Args:
        image: (H, W) or (H, W, 3), uint8 or uint16, in the ROS encoding `encoding`.
        settings: values of COMPRESSED_FIELDS.

    Raises:
        CameraError: when OpenCV cannot encode it.
    """
    jpeg = settings["format"] == "jpeg"
    target = ""
    if encoding in _COLOUR:
        if _COLOUR[encoding] is not None:
            image = cv2.cvtColor(image, _COLOUR[encoding])
        target = "bgr8" if jpeg or image.dtype == np.uint8 else "bgr16"
    if jpeg:
        if image.dtype == np.uint16:  # JPEG has eight bits; 65535 / 257 = 255
            image = (image // 257).astype(np.uint8)
        options = [
            cv2.IMWRITE_JPEG_QUALITY, settings["jpeg_quality"],
            cv2.IMWRITE_JPEG_PROGRESSIVE, int(settings["jpeg_progressive"]),
            cv2.IMWRITE_JPEG_OPTIMIZE, int(settings["jpeg_optimize"]),
            cv2.IMWRITE_JPEG_RST_INTERVAL, settings["jpeg_restart_interval"],
        ]  # fmt: skip
    else:
        options = [cv2.IMWRITE_PNG_COMPRESSION, settings["png_level"]]
    done, data = cv2.imencode(".jpg" if jpeg else ".png", image, options)
    if not done:
        raise CameraError(f"OpenCV cannot write a {image.shape} {encoding} image as "
                          f"{settings['format']}")
    return f"{encoding}; {settings['format']} compressed {target}", data.tobytes()


class CompressedTopic:
    """Publishes frames compressed, from a thread of its own: the simulation goes on meanwhile."""

    # As many frames wait at most; then the simulation waits, so that a bag misses none.
    BACKLOG = 4

    def __init__(self, image_topic: str, listener: rospy.SubscribeListener) -> None:
        """Advertise `<image_topic>/compressed` and its settings; `listener` hears subscribers."""
        topic = f"{image_topic}/compressed"
        self._topic = topic
        self._settings = ReconfigureServer(topic, COMPRESSED_FIELDS, _given(topic), _checked)
        self._publisher = rospy.Publisher(
            topic, CompressedImage, latch=True, queue_size=2, subscriber_listener=listener,
            tcp_nodelay=True,
        )  # fmt: skip
        self._frames: queue.Queue[tuple[Time, str, Any] | None] = queue.Queue(self.BACKLOG)
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=f"compress {topic}", daemon=True)
        self._thread.start()

    @property
    def wanted(self) -> bool:
        """Whether somebody subscribes."""
        return listeners(self._publisher) > 0

    def publish(self, stamp: Time, frame_id: str, frame: Any) -> None:
        """Hand over one camera Frame; its arrays must not change afterwards."""
        while not self._closed:
            try:
                self._frames.put((stamp, frame_id, frame), timeout=0.5)
                return
            except queue.Full:
                continue

    def shutdown(self) -> None:
        """Take topic and settings off the graph."""
        self._closed = True
        with self._frames.mutex:
            self._frames.queue.clear()
            self._frames.not_full.notify_all()
        self._frames.put(None)
        self._settings.shutdown()
        self._publisher.unregister()

    def _run(self) -> None:
        while (item := self._frames.get()) is not None:
            stamp, frame_id, frame = item
            try:
                text, data = encode(frame.image, frame.encoding, self._settings.values)
                header = Header(stamp=stamp, frame_id=frame_id)
                self._publisher.publish(CompressedImage(header, text, data))
            except (CameraError, cv2.error) as error:
                rospy.logerr_throttle(5.0, f"{self._topic}: {error}")
            except rospy.ROSException:  # the topic was closed meanwhile
                self._closed = True
                return


def _given(topic: str) -> dict[str, Any]:
    """Settings that the parameter server holds already, as image_transport reads them at start."""
    values = rospy.get_param(topic, {})
    if not isinstance(values, dict):
        return {}
    found: dict[str, Any] = {}
    for field in COMPRESSED_FIELDS:
        if field.name not in values:
            continue
        try:
            found[field.name] = field.coerce(values[field.name])
            _checked({**found, "format": found.get("format", "jpeg")})
        except (SimError, TypeError):
            rospy.logerr(
                "%s/%s is %r; going on with %r", topic, field.name, values[field.name],
                field.default,
            )  # fmt: skip
            found.pop(field.name, None)
    return found


def _checked(values: dict[str, Any]) -> None:
    if values["format"] not in ("jpeg", "png"):
        raise CameraError(f"format '{values['format']}' is neither jpeg nor png")


