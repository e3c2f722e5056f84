"""Publishers of the images, point clouds and segmentation labels of one camera.

All calls of one publisher must come from the same thread. Any thread may call the function
`on_change`, which a publisher calls when subscribers connect or leave.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import yaml
from genpy import Time
from sensor_msgs.msg import Image, PointCloud2, PointField
from std_msgs.msg import String

from aras_sim_bridge.camera import CameraReading
from aras_sim_bridge.camera.point_clouds import COLOUR, POINT_FLOATS, compute_points
from aras_sim_bridge.description import DepthDescription
from aras_sim_bridge.ros.runtime.publisher import NonBlockingPublisher
from aras_sim_bridge.simulation import Simulation
from aras_sim_bridge.world.labels import list_links_by_label

_FIELDS = [
    PointField(name, 4 * place, PointField.FLOAT32, 1)
    for name, place in (("x", 0), ("y", 1), ("z", 2), ("rgb", COLOUR))
]


class ImageTopic(NonBlockingPublisher):
    """Latched image publisher, like those of Gazebo; it does not copy the pixels."""

    def __init__(self, topic: str, on_change: Callable[[], None]) -> None:
        """Advertise the topic."""
        super().__init__(topic, Image, queue_size=2, latch=True, on_change=on_change)

    def send(self, stamp: Time, frame_id: str, pixels: np.ndarray, encoding: str) -> None:
        """Publish an image; the pixels must not change afterwards.

        Args:
            stamp: time of the exposure.
            frame_id: optical frame of the camera.
            pixels: image (H, W) or (H, W, 3).
            encoding: ROS encoding of the pixels.
        """
        pixels = np.ascontiguousarray(pixels)
        message = Image(encoding=encoding, step=pixels.strides[0])
        message.header.stamp, message.header.frame_id = stamp, frame_id
        message.height, message.width = pixels.shape[:2]
        self.publish_array(message, pixels)


class PointsTopic(NonBlockingPublisher):
    """Publisher of point clouds in the optical frame."""

    def __init__(
        self,
        topic: str,
        rays: np.ndarray,
        settings: DepthDescription,
        on_change: Callable[[], None],
    ) -> None:
        """Advertise the topic.

        Args:
            topic: name of the topic.
            rays: (H, W, 3) ray of each pixel in the optical frame. The ray times the pixel's depth
                is the visible point.
            settings: settings of the depth topics.
            on_change: see the top of this file.
        """
        self._rays, self._settings = rays, settings
        super().__init__(topic, PointCloud2, queue_size=1, on_change=on_change)

    def send(self, stamp: Time, frame_id: str, frame: CameraReading) -> None:
        """Publish the point cloud of a frame that contains a depth image."""
        if not self.subscriber_count:
            return
        image = frame.image[..., ::-1] if frame.encoding.startswith("bgr") else frame.image
        points = compute_points(self._rays, frame.depth, image, self._settings)
        message = PointCloud2(fields=_FIELDS, point_step=4 * POINT_FLOATS)
        message.header.stamp, message.header.frame_id = stamp, frame_id
        height, width = points.shape[:2]
        if not self._settings.rows:
            height, width = 1, height * width
        message.height, message.width = height, width
        message.row_step = message.point_step * width
        message.is_dense = bool(np.isfinite(points[..., 2]).all())
        # one byte follows the array in the message: the field is_dense
        self.publish_array(message, points, trailing_bytes=1)


class LabelTopic(NonBlockingPublisher):
    """Latched topic that maps the numbers in segmentation images to names `model::link`.

    The message is a YAML text.
    """

    def __init__(self, topic: str, on_change: Callable[[], None]) -> None:
        """Advertise the topic."""
        super().__init__(topic, String, queue_size=2, latch=True, on_change=on_change)
        self._labels: tuple[tuple[str, int], ...] | None = None

    def update(self, simulation: Simulation) -> None:
        """Publish the map if the models have changed; call this in the simulation thread."""
        models = simulation.world.models
        labels = tuple((name, model.body_id) for name, model in models.items())
        if labels == self._labels:
            return
        self._labels = labels
        self.publish(String(yaml.safe_dump(list_links_by_label(models))))
