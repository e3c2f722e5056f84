"""An ArUco or AprilTag marker."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.settings import parameter
from aras_visual_servo_camera.markers import MarkerChoice

from ..geometry import IMAGE_FLIP, Target
from .base import SHAPES, FlatShape


@SHAPES.register("marker")
class Marker(FlatShape):
    """An ArUco or AprilTag marker with a white border."""

    tracker = "marker"

    marker: str = parameter(
        "",
        help="dictionary and number, such as 5 or DICT_5X5_100:5; '' for AprilTag 36h11 number 0",
    )

    def make(self) -> Target:
        """Return a rectangle with the marker; the marker's corners are the points of the target."""
        from ..textures import TexturedTarget, make_blank_image

        choice = MarkerChoice.read(self.marker, "target.marker")
        pixels, _ = make_blank_image(self.size)
        # number of cells along a side of the marker, with a white border that is one cell wide
        cells = choice.cells + 2
        side = min(pixels.shape) // cells * choice.cells
        tag = choice.draw_marker(side)
        top, left = ((n - side) // 2 for n in pixels.shape)
        pixels[top : top + side, left : left + side] = tag
        per_metre = pixels.shape[1] / self.size[0]
        corners = np.array([[0, 0], [side, 0], [side, side], [0, side]], float) + (left, top)
        points = (corners / per_metre - 0.5 * np.asarray(self.size)) * IMAGE_FLIP
        return TexturedTarget(pixels, self.size, points)
