"""Subscribers to a camera's label images, in which each pixel contains the number of a link."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import rospy
from sensor_msgs.msg import Image as ImageMessage
from std_msgs.msg import String

from .errors import VisionError
from .label_segmentation import LabelSegmentation, read_labels
from .segmentation_settings import SegmentationSettings
from .segmented_target import Mask

# Size of a subscriber's buffer, bytes, enough for several images. With a buffer smaller than an
# image, rospy would deliver old images.
BUFFER_SIZE = 2**24
LabelCallback = Callable[[str, ImageMessage], None]


class LabelSubscribers:
    """Subscribers to the label images of one camera and to the names of the labels.

    A label is the number that the pixels of one link of a model have in a label image. Its name is
    'model::link'.

    Attributes:
        topic: resolved name of the topic of the label images.
        subscribers: [subscriber to the names, subscriber to the images].
    """

    def __init__(self, camera: str, label: str, callback: LabelCallback) -> None:
        """Subscribe to the label images and to the names of the labels.

        Args:
            camera: namespace of the camera's topics.
            label: name of the target, 'model' or 'model::link'.
            callback: function that is called with the text 'labels' and the message of each label
                image.
        """
        self._target_labels = LabelSegmentation(label)
        self.topic = rospy.resolve_name(f"{camera}/segmentation/image_raw")
        options = {"queue_size": 1, "tcp_nodelay": True}
        self.subscribers = [
            rospy.Subscriber(f"{camera}/segmentation/labels", String, self._on_names, **options),
            rospy.Subscriber(self.topic, ImageMessage, partial(callback, "labels"),
                             buff_size=BUFFER_SIZE, **options),
        ]  # fmt: skip

    @classmethod
    def for_segmentation(
        cls, segmentation: SegmentationSettings, camera: str, callback: LabelCallback
    ) -> LabelSubscribers | None:
        """Return the subscribers for segmentation by label; None for any other method."""
        if "labels" not in segmentation.image_kinds:
            return None
        return cls(camera, segmentation.label, callback)

    def make_mask(self, message: ImageMessage) -> Mask:
        """Return the target's mask (rows, columns), 255 where a label image shows the target.

        Raises:
            VisionError: the label image is invalid, or no known label has the target's name.
        """
        return self._target_labels.make_mask(read_labels(message))

    def _on_names(self, message: String) -> None:
        try:
            self._target_labels.set_links(message.data)
        except VisionError as error:
            rospy.logwarn_throttle(5.0, str(error))
