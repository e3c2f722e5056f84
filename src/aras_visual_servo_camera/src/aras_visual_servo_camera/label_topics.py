"""Subscribers to the label images of a camera, and the target's pixels in these images."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import rospy
from sensor_msgs.msg import Image as ImageMessage
from std_msgs.msg import String

from .errors import VisionError
from .labels import TargetLabels, read_labels
from .segmentation import Segmentation
from .segmented_target import Mask

BUFFER_SIZE = 2**24  # bytes; holds several images, so that the newest one is always read
LabelCallback = Callable[[str, ImageMessage], None]


class LabelTopics:
    """Subscribers to the label images of one camera and to the names of their labels.

    Attributes:
        topic: resolved name of the image topic.
        subscribers: the two subscribers.
    """

    def __init__(self, camera: str, label: str, callback: LabelCallback) -> None:
        """Subscribe to both topics.

        Args:
            camera: namespace of the camera's topics.
            label: name of the target, 'model' or 'model::link'.
            callback: called with 'labels' and each label image.
        """
        self._target_labels = TargetLabels(label)
        self.topic = rospy.resolve_name(f"{camera}/segmentation/image_raw")
        options = {"queue_size": 1, "tcp_nodelay": True}
        self.subscribers = [
            rospy.Subscriber(f"{camera}/segmentation/labels", String, self._on_names, **options),
            rospy.Subscriber(self.topic, ImageMessage, partial(callback, "labels"),
                             buff_size=BUFFER_SIZE, **options),
        ]  # fmt: skip

    @classmethod
    def for_segmentation(
        cls, segmentation: Segmentation, camera: str, callback: LabelCallback
    ) -> LabelTopics | None:
        """Return the subscribers that a segmentation needs, or None if it uses no labels."""
        return (
            cls(camera, segmentation.label, callback)
            if "labels" in segmentation.image_kinds
            else None
        )

    def make_mask(self, message: ImageMessage) -> Mask:
        """Return a mask (rows, columns), 255 where a label image shows the target.

        Raises:
            VisionError: the names of the labels are unknown, or none of them is the target.
        """
        return self._target_labels.make_mask(read_labels(message))

    def _on_names(self, message: String) -> None:
        try:
            self._target_labels.set_links(message.data)
        except VisionError as error:
            rospy.logwarn_throttle(5.0, str(error))
