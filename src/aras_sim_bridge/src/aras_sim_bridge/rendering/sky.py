"""Colours of a clear sky, and of haze below the horizon."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import jit

from .packed_colours import pack_colour
from .tiles import TILE, Tiles

# Colours of the sky (red, green, blue; 0..1): at the zenith, at the horizon, and straight down.
ZENITH, HORIZON, HAZE = (0.22, 0.42, 0.78), (0.80, 0.88, 0.95), (0.52, 0.52, 0.50)
# Colour that represents the whole sky in edge detection (red, green, blue; 0..1).
MIDDLE = (0.51, 0.65, 0.87)
NO_SKY = np.zeros((0, 0), np.uint32)


def draw_sky(tiles: Tiles, world_T_optical: np.ndarray) -> np.ndarray:
    """Return the packed colours (uint32) of the sky; the image is enlarged to whole tiles."""
    out = np.empty((tiles.rows * TILE, tiles.columns * TILE), np.uint32)
    _fill(tiles.matrices, tiles.cells, tiles.columns, np.ascontiguousarray(world_T_optical[2, :3]),
          np.array([ZENITH, HORIZON, HAZE]), out)
    return out


@jit("f8[:,:,::1], i8, i8, f8[::1], f8[:,::1], u4[:,::1]")
def _fill(matrices, cells, columns, up, colours, out):
    size, rgb = TILE // cells, np.empty(3)
    for v in range(out.shape[0]):
        for u in range(out.shape[1]):
            n = (v // TILE) * columns + u // TILE
            M = matrices[n * cells * cells + (v % TILE // size) * cells + u % TILE // size]
            length = height = 0.0
            for j in range(3):
                ray = M[j, 0] * (u % size) + M[j, 1] * (v % size) + M[j, 2]
                length += ray * ray
                height += up[j] * ray
            height /= np.sqrt(max(length, 1e-300))
            # `height` is the sine of the ray's elevation. Above the horizon, the colour changes
            # quickly to that of the zenith; below it, to haze within ten degrees.
            share = np.sqrt(height) if height > 0.0 else min(-6.0 * height, 1.0)
            other = 0 if height > 0.0 else 2
            for j in range(3):
                rgb[j] = 255.0 * (colours[1, j] + share * (colours[other, j] - colours[1, j]))
            out[v, u] = pack_colour(rgb[0], rgb[1], rgb[2])
