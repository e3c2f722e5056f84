"""ROS interface of the camera node: subscribers, publishers, and reports of bad images."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from threading import Lock
from typing import Any

import rospy
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import Image as ImageMessage

from aras_visual_servo_base.stamp_synchronizer import StampSynchronizer
from aras_visual_servo_ros.shutdown import iterate_at_period

from .camera_model import CameraModel
from .detection_pipeline import DetectionPipeline
from .detection_publishers import MOMENTS_TOPIC, DetectionPublishers
from .errors import InvalidIntrinsicsError, VisionError
from .images import decode
from .label_subscribers import BUFFER_SIZE, LabelSubscribers
from .parameters import VisionParameters

CAMERA = "/labrob/camera"
IMAGE_TOPIC, INFO_TOPIC = f"{CAMERA}/image_raw", f"{CAMERA}/camera_info"


class CameraNode:
    """ROS interface of DetectionPipeline. It logs errors in one line each, at a limited rate.

    Attributes:
        moments_topic: name of the topic of the moments, as it is before remapping.
        on_moments: function that is called with the ImageMoments message of each image, for a
            controller in the same process; None if there is none.
    """

    moments_topic = MOMENTS_TOPIC

    def __init__(self, parameters: VisionParameters) -> None:
        self.on_moments: Callable[[Any], None] | None = None
        self.parameters = parameters
        mask = parameters.read_mask_image()
        self.pipeline = DetectionPipeline(parameters.pipeline_settings, mask)
        self.pipeline.drop_camera(f"no camera_info on {rospy.resolve_name(INFO_TOPIC)} yet")
        self._log_times: dict[str, float] = {}
        self._lock, self._stamp, self._last_image = Lock(), rospy.Time(), time.monotonic()
        self._publishers = DetectionPublishers(parameters, self.pipeline, self._log)
        segmentation = parameters.pipeline_settings.segmentation
        self._pairing = StampSynchronizer(segmentation.image_kinds)
        self._label_subscribers = LabelSubscribers.for_segmentation(
            segmentation, CAMERA, self._add_image
        )
        options = {"queue_size": 1, "tcp_nodelay": True, "buff_size": BUFFER_SIZE}
        rospy.Subscriber(INFO_TOPIC, CameraInfo, self._on_info, **options)
        rospy.Subscriber(IMAGE_TOPIC, ImageMessage, partial(self._add_image, "image"), **options)

    def spin(self) -> None:
        """Run until shutdown or until the ROS master has stopped; log if no images arrive."""
        for _ in iterate_at_period(0.2):
            self.check_images()

    def check_images(self) -> None:
        """Log if no images arrive; this method must be called often."""
        if time.monotonic() - self._last_image > self.parameters.log_period:
            topics = [rospy.resolve_name(IMAGE_TOPIC)]
            if self._label_subscribers:
                topics.append(self._label_subscribers.topic)
            self._log("image", f"waiting for images on {' and '.join(topics)}")

    def _on_info(self, message: CameraInfo) -> None:
        with self._lock:
            try:
                self.pipeline.set_camera(CameraModel.from_message(message))
            except InvalidIntrinsicsError as error:
                self.pipeline.drop_camera(str(error))

    def _add_image(self, kind: str, message: ImageMessage) -> None:
        with self._lock:
            messages = self._pairing.add(kind, message.header.stamp, message)
        if messages is None:
            return
        self._last_image = time.monotonic()
        try:
            image = decode(messages["image"])
            with self._lock:
                if message.header.stamp < self._stamp:
                    # the stamps have jumped back, e.g. at a reset of the simulation
                    self.pipeline.reset()
                self._stamp = message.header.stamp
                if (labels := self._label_subscribers) is not None:
                    image = replace(image, target_mask=labels.make_mask(messages["labels"]))
                measurement = self.pipeline.measure(image)
        except VisionError as error:
            self._log("image unusable", f"image skipped: {error}")
            return
        moments = self._publishers.publish(image, measurement, messages["image"])
        if self.on_moments is not None:
            self.on_moments(moments)

    def _log(self, key: str, text: str) -> None:
        now = time.monotonic()
        if now - self._log_times.get(key, -math.inf) >= self.parameters.log_period:
            self._log_times[key] = now
            rospy.logwarn(text)
