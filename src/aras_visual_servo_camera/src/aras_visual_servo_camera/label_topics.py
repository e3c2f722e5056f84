"""The topics of a camera's label images, and the target's pixels in them."""

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

BUFFER_SIZE = 2**24  # bytes, holds several images: always the newest, never a backlog
LabelCallback = Callable[[str, ImageMessage], None]


class LabelTopics:
    """Subscribers to the label images of one camera and to their names.

    Attributes:
        topic: of the images, as it is on the graph.
        subscribers: to both.
    """

    def __init__(self, camera: str, label: str, callback: LabelCallback) -> None:
        """Args:
            camera: namespace of its topics.
            label: model, or 'model::link', that is the target.
            take: is given 'labels' and each label image.
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
        """Those that a segmentation needs; None: it goes without."""
        return (
            cls(camera, segmentation.label, callback)
            if "labels" in segmentation.image_kinds
            else None
        )

    def make_mask(self, message: ImageMessage) -> Mask:
        """(rows, columns) 255 where a label image has the target; VisionError: nobody knows."""
        return self._target_labels.make_mask(read_labels(message))

    def _on_names(self, message: String) -> None:
        try:
            self._target_labels.set_links(message.data)
        except VisionError as error:
            rospy.logwarn_throttle(5.0, str(error))
