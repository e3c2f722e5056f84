"""Publisher of the depth images of one camera as sensor_msgs/PointCloud2."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from genpy import Time
from sensor_msgs.msg import PointCloud2, PointField

from aras_sim_bridge.camera import CameraReading
from aras_sim_bridge.camera.point_cloud_builder import COLOUR, POINT_FLOATS, PointCloudBuilder
from aras_sim_bridge.description import DepthDescription
from aras_sim_bridge.ros.runtime.publisher import NonBlockingPublisher

_FIELDS = [
    PointField(name, 4 * place, PointField.FLOAT32, 1)
    for name, place in (("x", 0), ("y", 1), ("z", 2), ("rgb", COLOUR))
]


class PointsTopic(NonBlockingPublisher):
    """Publisher of point clouds in the optical frame; all calls must come from one thread."""

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
            on_change: called from any thread when subscribers connect or leave.
        """
        self._cloud = PointCloudBuilder(rays, settings)
        self._rows = settings.rows
        super().__init__(topic, PointCloud2, queue_size=1, on_change=on_change)

    def send(self, stamp: Time, frame_id: str, frame: CameraReading) -> None:
        """Publish the point cloud of a frame that contains a depth image."""
        if not self.subscriber_count:
            return
        image = frame.image[..., ::-1] if frame.encoding.startswith("bgr") else frame.image
        points = self._cloud.compute_points(frame.depth, image)
        message = PointCloud2(fields=_FIELDS, point_step=4 * POINT_FLOATS)
        message.header.stamp, message.header.frame_id = stamp, frame_id
        height, width = points.shape[:2]
        if not self._rows:
            height, width = 1, height * width
        message.height, message.width = height, width
        message.row_step = message.point_step * width
        message.is_dense = bool(np.isfinite(points[..., 2]).all())
        # one byte follows the array in the message: the field is_dense
        self.publish_array(message, points, trailing_bytes=1)
