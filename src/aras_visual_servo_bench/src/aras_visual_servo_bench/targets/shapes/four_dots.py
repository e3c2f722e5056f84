"""Four dots."""

from __future__ import annotations

import numpy as np

from ..geometry import IMAGE_FLIP, Target
from .base import SHAPES, FlatShape


@SHAPES.register("four_dots")
class FourDots(FlatShape):
    """Four black dots on white at a quarter from the rim, a tenth of the width across."""

    tracker = "dots"

    def make(self) -> Target:
        """Return the rectangle with the dots, whose middles are known."""
        from ..textures import TexturedTarget, make_blank_image

        w, h = size = self.size
        middles = 0.25 * np.array([[-w, -h], [w, -h], [w, h], [-w, h]])
        pixels, per = make_blank_image(size)
        for x, y in middles:
            centre = ((x + 0.5 * w) * per - 0.5, (y + 0.5 * h) * per - 0.5)
            _draw_disc(pixels, centre, 0.05 * w * per)
        return TexturedTarget(pixels, size, middles * IMAGE_FLIP)


def _draw_disc(pixels: np.ndarray, centre: tuple[float, float], radius: float) -> None:
    """A black disc with smooth edges, px."""
    left, top = (max(int(middle - radius) - 1, 0) for middle in centre)
    right, bottom = (int(middle + radius) + 3 for middle in centre)
    part = pixels[top:bottom, left:right]
    v, u = np.indices(part.shape)
    inside = np.clip(
        radius + 0.5 - np.hypot(u + (left - centre[0]), v + (top - centre[1])), 0.0, 1.0)
    np.minimum(part, np.round(255.0 * (1.0 - inside)).astype(np.uint8), out=part)
