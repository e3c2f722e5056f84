"""Topic image_raw/compressed with the settings of image_transport's compressed plug-in."""

from __future__ import annotations

import collections
import threading
from collections.abc import Callable

import cv2
import numpy as np
import rospy
from genpy import Time
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import Header

from aras_sim_bridge.camera import CameraReading
from aras_sim_bridge.errors import CameraError
from aras_sim_bridge.ros.runtime.publisher import SubscriberWatch, list_connections
from aras_visual_servo_ros.parameters import InvalidParameterError, Value, get_namespace
from aras_visual_servo_ros.reconfigure import ReconfigurableParameter, ReconfigureServer

# Settings of a compressed topic, with the names, defaults and limits of compressed_image_transport.
# Each row: name, type, default, minimum, maximum, description.
COMPRESSED_FIELDS = tuple(ReconfigurableParameter(*row) for row in (
    ("format", "str", "jpeg", "", "", "Compression format: jpeg or png"),
    ("jpeg_quality", "int", 80, 1, 100, "JPEG quality percentile"),
    ("jpeg_progressive", "bool", False, False, True, "Progressive compression for JPEG"),
    ("jpeg_optimize", "bool", False, False, True, "Optimised Huffman tables for JPEG"),
    ("jpeg_restart_interval", "int", 0, 0, 65535, "Restart interval for JPEG"),
    ("png_level", "int", 9, 1, 9, "PNG compression level"),
))  # fmt: skip
_COLOUR = {"rgb8": cv2.COLOR_RGB2BGR, "rgb16": cv2.COLOR_RGB2BGR, "bgr8": None}


def encode(image: np.ndarray, encoding: str, settings: dict[str, Value]) -> tuple[str, bytes]:
    """Compress an image; return the field `format` of CompressedImage and the compressed bytes.

    Args:
        image: (H, W) or (H, W, 3), uint8 or uint16, in the ROS encoding `encoding`.
        encoding: ROS encoding of the image.
        settings: values of COMPRESSED_FIELDS.

    Raises:
        CameraError: OpenCV cannot encode the image.
    """
    jpeg = settings["format"] == "jpeg"
    target = ""
    if encoding in _COLOUR:
        if _COLOUR[encoding] is not None:
            image = cv2.cvtColor(image, _COLOUR[encoding])
        target = "bgr8" if jpeg or image.dtype == np.uint8 else "bgr16"
    if jpeg:
        # JPEG has 8 bits per channel; 65535 / 257 is 255.
        if image.dtype == np.uint16:
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
                          f"{settings['format']}; set format to {'png' if jpeg else 'jpeg'}")
    return f"{encoding}; {settings['format']} compressed {target}", data.tobytes()


class CompressedTopic:
    """Publisher of compressed images, which are compressed in a background thread."""

    # largest number of frames that wait for compression; if there are more, the oldest is dropped
    BACKLOG = 4
    # Number of images that may wait for a subscriber: those of about one second, so that a recorder
    # that is briefly busy misses no image. Compressed images are small, so this needs little
    # memory.
    QUEUE = 30

    def __init__(self, image_topic: str, subscriber_watch: SubscriberWatch) -> None:
        """Advertise `<image_topic>/compressed` and the settings of this topic.

        `subscriber_watch` is called when subscribers connect or leave.
        """
        topic = f"{image_topic}/compressed"
        self._topic = topic
        self._settings = ReconfigureServer(
            topic, COMPRESSED_FIELDS, _read_parameters(topic), _check_settings
        )
        self._publisher = rospy.Publisher(
            topic, CompressedImage, latch=True, queue_size=self.QUEUE,
            subscriber_listener=subscriber_watch,
            tcp_nodelay=True,
        )  # fmt: skip
        # Lock that is held during publish and unregister: rospy fails if a topic is unregistered
        # during publish.
        self._publishing = threading.Lock()
        self._worker = BackgroundWorker(self._send, self.BACKLOG, f"compress {topic}")

    @property
    def subscriber_count(self) -> int:
        """Number of subscribers."""
        return len(list_connections(self._publisher))

    def publish(self, stamp: Time, frame_id: str, frame: CameraReading) -> None:
        """Compress and publish a camera frame in the background.

        The arrays of the frame must not change afterwards.
        """
        self._worker.put((Header(stamp=stamp, frame_id=frame_id), frame))

    def unregister(self) -> None:
        """Unregister the topic and its settings."""
        self._worker.stop()
        self._settings.shutdown()
        with self._publishing:
            self._publisher.unregister()

    def _send(self, item: tuple[Header, CameraReading]) -> None:
        header, frame = item
        try:
            text, data = encode(frame.image, frame.encoding, self._settings.values)
            with self._publishing:
                self._publisher.publish(CompressedImage(header, text, data))
        except (CameraError, cv2.error) as error:
            rospy.logerr_throttle(5.0, f"{self._topic}: {error}")
        # The topic was closed during the compression.
        except rospy.ROSException:
            self._worker.stop()


class BackgroundWorker:
    """Thread that processes items from a bounded queue; a full queue drops its oldest item."""

    def __init__(
        self, work: Callable[[tuple[Header, CameraReading]], None], backlog: int, name: str
    ) -> None:
        """Start the thread; it calls `work` with each item, and at most `backlog` items wait."""
        self._work = work
        self._items = collections.deque[tuple[Header, CameraReading]](maxlen=backlog)
        self._wake_up = threading.Event()
        self._stopped = False
        threading.Thread(target=self._run, name=name, daemon=True).start()

    def put(self, item: tuple[Header, CameraReading]) -> None:
        """Add an item to the queue without waiting; if the queue is full, drop its oldest item."""
        self._items.append(item)
        self._wake_up.set()

    def stop(self) -> None:
        """End the thread and drop the waiting items; may be called from any thread."""
        self._stopped = True
        self._wake_up.set()

    def _run(self) -> None:
        while not self._stopped:
            self._wake_up.wait()
            self._wake_up.clear()
            while self._items and not self._stopped:
                self._work(self._items.popleft())


def _read_parameters(topic: str) -> dict[str, Value]:
    """Return the valid settings of `topic` on the parameter server.

    An error is logged for each invalid setting.
    """
    values = get_namespace(topic)
    settings: dict[str, Value] = {}
    for field in COMPRESSED_FIELDS:
        if field.name not in values:
            continue
        try:
            settings[field.name] = field.coerce(values[field.name])
            _check_settings({**settings, "format": settings.get("format", "jpeg")})
        except (CameraError, InvalidParameterError, TypeError):
            rospy.logerr(
                "%s/%s is invalid: %r; using the default %r", topic, field.name,
                values[field.name], field.default,
            )  # fmt: skip
            settings.pop(field.name, None)
    return settings


def _check_settings(values: dict[str, Value]) -> None:
    if values["format"] not in ("jpeg", "png"):
        raise CameraError(f"format '{values['format']}' is neither jpeg nor png; use one of these")
