"""A grid of lines."""

from __future__ import annotations

import numpy as np

from ..geometry import IMAGE_FLIP, Target
from .base import SHAPES, FlatShape


@SHAPES.register("line_grid")
class LineGrid(FlatShape):
    """Black lines on white, five by five."""

    tracker = "lines"

    def make(self) -> Target:
        """Return the rectangle with the lines; the crossings of the outermost four are known."""
        from ..textures import TexturedTarget, make_blank_image

        w, h = size = self.size
        pixels, per = make_blank_image(size)
        wide = max(int(round(0.01 * w * per)), 1)
        across = np.linspace(-0.4, 0.4, 5)
        for part in across:
            u, v = ((part + 0.5) * w * per, (part + 0.5) * h * per)
            low_u, low_v = int(round(u - 0.5 * wide)), int(round(v - 0.5 * wide))
            first, last = (int(round(p * h * per)) for p in (0.1, 0.9))
            pixels[first:last, low_u : low_u + wide] = 0
            first, last = (int(round(p * w * per)) for p in (0.1, 0.9))
            pixels[low_v : low_v + wide, first:last] = 0
        low, high = across[0], across[-1]
        crossings = np.array([(low, low), (high, low), (high, high), (low, high)]) * size
        return TexturedTarget(pixels, size, crossings * IMAGE_FLIP)
