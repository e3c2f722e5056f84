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
        self,
        parameters: VisionParameters,
        pipeline: DetectionPipeline,
        log: Callable[[str, str], None],
    ) -> None:
        """Create the publishers.

        Args:
            parameters: parameters of the node.
            pipeline: pipeline that computes the arrays of the original ARAS simulator.
            log: function that is called with the kind of an error and with its message.
        """
        # catkin generates these messages when it builds the workspace.
        from .msg import ImageMoments, KernelFeatures

        self._parameters, self._pipeline, self._log = parameters, pipeline, log
        self._moments_publisher = rospy.Publisher(MOMENTS_TOPIC, ImageMoments, queue_size=1)
        self._data_publisher = rospy.Publisher(NAMESPACE + "data", Float64MultiArray, queue_size=1)
        self._kernel_publisher = rospy.Publisher(NAMESPACE + "kernel", KernelFeatures, queue_size=1)
        self._binary_publisher = rospy.Publisher(
            NAMESPACE + "thresholded_image", ImageMessage, queue_size=1
        )
        self._overlay_publisher = rospy.Publisher(NAMESPACE + "overlay", ImageMessage, queue_size=1)
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
        self._moments_publisher.publish(moments)
        if not detection.valid:
            # Reasons that differ only in numbers are logged as the same kind of error.
            kind = re.sub(r"[\d.]+", "#", detection.reason)
            self._log(kind, f"no measurement: {detection.reason}")
        if self._kernel_publisher.get_num_connections():
            self._publish_kernel(image, message)
        if self._data_publisher.get_num_connections():
            self._publish_original(image)
        if self._binary_publisher.get_num_connections():
            mask = detection.target.mask
            self._binary_publisher.publish(make_image_message(mask, "mono8", message.header))
        if self._overlay_publisher.get_num_connections():
            overlay = draw(image.rgb, detection, self._desired_outline)
            self._overlay_publisher.publish(make_image_message(overlay, "rgb8", message.header))
        return moments

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
        self._kernel_publisher.publish(make_kernel_message(numbers, reason, message.header))

    def _publish_original(self, image: Image) -> None:
        try:
            numbers = self._pipeline.compute_original_data(image)
        except VisionError as error:
            # The original simulator published zeros or NaN instead. Nothing is published here, so
            # that a controller that subscribes to this topic stops the arm.
            self._log("data", f"nothing is published on {NAMESPACE}data: {error}")
            return
        self._data_publisher.publish(make_array_message(numbers))
