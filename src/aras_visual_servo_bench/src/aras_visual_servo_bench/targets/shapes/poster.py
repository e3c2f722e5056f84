"""A textured poster for feature points and photometric visual servoing."""

from __future__ import annotations

import numpy as np

from ..geometry import Target
from .base import SHAPES, FlatShape

SEED = 41


@SHAPES.register("poster")
class Poster(FlatShape):
    """Poster with random shapes and with noise at all scales."""

    def make(self) -> Target:
        """Return a rectangle with the texture; the texture is always the same."""
        import cv2

        from ..textures import TexturedTarget, make_blank_image

        random = np.random.default_rng(SEED)
        pixels, _ = make_blank_image(self.size)
        rows, columns = pixels.shape
        noise = np.zeros((rows, columns), np.float32)
        for cells in (4, 8, 16, 32, 64):
            coarse = random.normal(size=(cells, cells)).astype(np.float32)
            noise += cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_CUBIC) / cells**0.5
        pixels[:] = np.clip(128.0 + 50.0 * noise, 30, 225)
        for _ in range(160):
            u, v = random.uniform(0, columns), random.uniform(0, rows)
            radius = columns * random.choice([0.01, 0.02, 0.04, 0.08])
            level = int(random.integers(0, 256))
            corners = random.uniform(-1.0, 1.0, (random.integers(3, 7), 2)) * radius + (u, v)
            cv2.fillPoly(pixels, [cv2.convexHull(corners.astype(np.int32))], level, cv2.LINE_AA)
        return TexturedTarget(pixels, self.size)
