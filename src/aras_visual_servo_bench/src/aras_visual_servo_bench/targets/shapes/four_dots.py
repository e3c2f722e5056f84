"""Four dots."""

from __future__ import annotations

import numpy as np

from ..geometry import IMAGE_FLIP, Target
from .base import SHAPES, FlatShape


@SHAPES.register("four_dots")
class FourDots(FlatShape):
    """Four black dots on white.

    Their centres are a quarter of the size away from the border, and their diameter is a tenth of
    the width.
    """

    tracker = "dots"

    def make(self) -> Target:
        """Return a rectangle with the dots; the centres of the dots are the target's points."""
        from ..textures import TexturedTarget, make_blank_image

        w, h = size = self.size
        centres = 0.25 * np.array([[-w, -h], [w, -h], [w, h], [-w, h]])
        pixels, per_metre = make_blank_image(size)
        for x, y in centres:
            centre = ((x + 0.5 * w) * per_metre - 0.5, (y + 0.5 * h) * per_metre - 0.5)
            _draw_disc(pixels, centre, 0.05 * w * per_metre)
        return TexturedTarget(pixels, size, centres * IMAGE_FLIP)


def _draw_disc(pixels: np.ndarray, centre: tuple[float, float], radius: float) -> None:
    """Draw a black disc with smooth edges; `centre` is (column, row), px, and `radius` is in px."""
    left, top = (max(int(middle - radius) - 1, 0) for middle in centre)
    right, bottom = (int(middle + radius) + 3 for middle in centre)
    part = pixels[top:bottom, left:right]
    v, u = np.indices(part.shape)
    inside = np.clip(
        radius + 0.5 - np.hypot(u + (left - centre[0]), v + (top - centre[1])), 0.0, 1.0)
    np.minimum(part, np.round(255.0 * (1.0 - inside)).astype(np.uint8), out=part)
