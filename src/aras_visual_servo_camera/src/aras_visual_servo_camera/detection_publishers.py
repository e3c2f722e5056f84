"""Publishers of the camera node.

The moments are always published. Every other message is computed only if it has a subscriber.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import rospy
from geometry_msgs.msg import PolygonStamped
from sensor_msgs.msg import Image as ImageMessage
from std_msgs.msg import Float64MultiArray

from .detection_pipeline import DetectionPipeline, TargetDetection
from .errors import VisionError
from .images import Image
from .messages import (
    make_array_message,
    make_image_message,
    make_kernel_message,
    make_moments_message,
    read_outline_message,
)
from .overlay import draw
from .parameters import VisionParameters

NAMESPACE = "/aras_visual_servo/camera/"
MOMENTS_TOPIC = f"{NAMESPACE}moments"
OUTLINE_TOPIC = "/aras_visual_servo/controller/desired_outline"


class DetectionPublishers:
    """Publishers of the results of one camera."""

    def __init__(
        self, parameters: VisionParameters, pipeline: DetectionPipeline,
        log: Callable[[str, str], None],
    ) -> None:  # fmt: skip
        """Create the publishers.

        Args:
            parameters: parameters of the node.
            pipeline: pipeline that computes the arrays of the original ARAS simulator.
            log: function that is called with the kind of an error and with its message.
        """
        # catkin generates these messages when it builds the workspace.
        from .msg import ImageMoments, KernelFeatures

        self._parameters, self._pipeline, self._log = parameters, pipeline, log
        kinds = {"moments": ImageMoments, "data": Float64MultiArray, "kernel": KernelFeatures,
                 "thresholded_image": ImageMessage, "overlay": ImageMessage}  # fmt: skip
        self._publishers = {
            name: rospy.Publisher(f"{NAMESPACE}{name}", kind, queue_size=1)
            for name, kind in kinds.items()
        }
        self._desired_outline = parameters.desired_corners
        if not self._desired_outline:
            rospy.Subscriber(OUTLINE_TOPIC, PolygonStamped, self._on_outline, queue_size=1)

    def publish(self, image: Image, detection: TargetDetection, message: ImageMessage) -> Any:
        """Publish the results of one image, and return the ImageMoments message.

        Args:
            image: decoded image.
            detection: target in this image.
            message: message of this image.
        """
        method = self._parameters.pipeline_settings.segmentation.method
        moments = make_moments_message(detection, message.header, method)
        self._publishers["moments"].publish(moments)
        if not detection.valid:
            # Reasons that differ only in numbers are logged as the same kind of error.
            kind = re.sub(r"[\d.]+", "#", detection.reason)
            self._log(kind, f"no measurement: {detection.reason}")
        if self._has_subscribers("kernel"):
            self._publish_kernel(image, message)
        if self._has_subscribers("data"):
            self._publish_original(image)
        if self._has_subscribers("thresholded_image"):
            mask = make_image_message(detection.target.mask, "mono8", message.header)
            self._publishers["thresholded_image"].publish(mask)
        if self._has_subscribers("overlay"):
            overlay = draw(image.rgb, detection, self._desired_outline)
            self._publishers["overlay"].publish(make_image_message(overlay, "rgb8", message.header))
        return moments

    def _has_subscribers(self, name: str) -> bool:
        return self._publishers[name].get_num_connections() > 0

    def _on_outline(self, message: PolygonStamped) -> None:
        """Store the desired outline that the controller publishes, for the overlay."""
        try:
            self._desired_outline = read_outline_message(message)
        except VisionError as error:
            self._log("outline", str(error))

    def _publish_kernel(self, image: Image, message: ImageMessage) -> None:
        numbers, reason = [], ""
        try:
            numbers = self._pipeline.compute_kernel_data(image)
        except VisionError as error:
            reason = str(error)
        self._publishers["kernel"].publish(make_kernel_message(numbers, reason, message.header))

    def _publish_original(self, image: Image) -> None:
        try:
            numbers = self._pipeline.compute_original_data(image)
        except VisionError as error:
            # The original simulator published zeros or NaN instead. Nothing is published here, so
            # that a controller that subscribes to this topic stops the arm.
            self._log("data", f"nothing is published on {NAMESPACE}data: {error}")
            return
        self._publishers["data"].publish(make_array_message(numbers))
