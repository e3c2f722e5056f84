"""A grid of lines."""

from __future__ import annotations

import numpy as np

from ..geometry import IMAGE_FLIP, Target
from .base import SHAPES, FlatShape


@SHAPES.register("line_grid")
class LineGrid(FlatShape):
    """Grid of five by five black lines on white."""

    tracker = "lines"

    def make(self) -> Target:
        """Return a rectangle with the lines; the outer four crossings are the target's points."""
        from ..textures import TexturedTarget, make_blank_image

        w, h = size = self.size
        pixels, per_metre = make_blank_image(size)
        line_width = max(int(round(0.01 * w * per_metre)), 1)
        positions = np.linspace(-0.4, 0.4, 5)
        for position in positions:
            u, v = (position + 0.5) * w * per_metre, (position + 0.5) * h * per_metre
            low_u, low_v = int(round(u - 0.5 * line_width)), int(round(v - 0.5 * line_width))
            first, last = (int(round(p * h * per_metre)) for p in (0.1, 0.9))
            pixels[first:last, low_u : low_u + line_width] = 0
            first, last = (int(round(p * w * per_metre)) for p in (0.1, 0.9))
            pixels[low_v : low_v + line_width, first:last] = 0
        low, high = positions[0], positions[-1]
        crossings = np.array([(low, low), (high, low), (high, high), (low, high)]) * size
        return TexturedTarget(pixels, size, crossings * IMAGE_FLIP)
