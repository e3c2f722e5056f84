"""The topics of a camera's label images, and the target's pixels in them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import rospy
from sensor_msgs.msg import Image as ImageMessage
from std_msgs.msg import String

from .errors import VisionError
from .labels import TargetLabels, labels_of
from .segmentation import Segmentation
from .segmented_target import Mask

BUFFER = 2**24  # bytes, holds several images: always the newest, never a backlog
Take = Callable[[str, ImageMessage], None]


class LabelTopics:
    """Subscribers to the label images of one camera and to their names.

    Attributes:
        topic: of the images, as it is on the graph.
        subscribers: to both.
    """

    def __init__(self, camera: str, label: str, take: Take) -> None:
        """Args:
            camera: namespace of its topics.
            label: model, or 'model::link', that is the target.
            take: is given 'labels' and each label image.
        """
        self._labels = TargetLabels(label)
        self.topic = rospy.resolve_name(f"{camera}/segmentation/image_raw")
        options = {"queue_size": 1, "tcp_nodelay": True}
        self.subscribers = [
            rospy.Subscriber(f"{camera}/segmentation/labels", String, self._on_names, **options),
            rospy.Subscriber(self.topic, ImageMessage, partial(take, "labels"),
                             buff_size=BUFFER, **options),
        ]  # fmt: skip

    @classmethod
    def asked(cls, segmentation: Segmentation, camera: str, take: Take) -> LabelTopics | None:
        """Those that a segmentation needs; None: it goes without."""
        return cls(camera, segmentation.label, take) if "labels" in segmentation.kinds else None

    def mask(self, message: ImageMessage) -> Mask:
        """(rows, columns) 255 where a label image has the target; VisionError: nobody knows."""
        return self._labels.mask(labels_of(message))

    def _on_names(self, message: String) -> None:
        try:
            self._labels.name(message.data)
        except VisionError as error:
            rospy.logwarn_throttle(5.0, str(error))
