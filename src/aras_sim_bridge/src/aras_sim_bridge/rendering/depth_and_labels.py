"""Depth and segmentation at the pixel centres."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import jit

from .binning import VisibleTriangles
from .pixel_visibility import PixelSamples
from .tiles import TILE, Tiles


def measure(tiles: Tiles, visible: VisibleTriangles, samples: PixelSamples, labels: np.ndarray
             ) -> tuple[np.ndarray, np.ndarray]:
    """Return the depth and the segmentation of a view, as described in Renderer.measure.

    Args:
        tiles: tiles of the image.
        visible: visible triangles.
        samples: samples at the pixel centres.
        labels: (N,) int32, labels of the visible triangles.
    """
    depth = np.empty((tiles.height, tiles.width), np.float32)
    label = np.empty((tiles.height, tiles.width), np.int32)
    _measure(samples.tile, samples.pixel, tiles.valid, visible.side, labels, tiles.matrices,
             tiles.exact, tiles.cells, tiles.columns, tiles.forward, depth, label)
    return depth, label


@jit("i8[::1], i4[:,::1], b1[:,::1], f8[:,:,::1], i4[::1], f8[:,:,::1], f4[:,:,::1], i8, i8, "
          "b1, f4[:,::1], i4[:,::1]")
def _measure(tile, pixel, valid, side, labels, matrices, exact, cells, columns, forward, depth,
             label):
    size = TILE // cells
    ray = np.empty(3)
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            n = (v // TILE) * columns + u // TILE
            m = tile[n] if tile[n] > -3 else pixel[v, u]
            if m < 0 or not valid[v, u]:
                depth[v, u], label[v, u] = np.inf, -1
                continue
            x, y = u % TILE, v % TILE
            M = matrices[n * cells * cells + (y // size) * cells + x // size]
            w = length = 0.0
            for j in range(3):
                if len(exact):
                    ray[j] = exact[v, u, j]
                else:
                    ray[j] = M[j, 0] * (x % size) + M[j, 1] * (y % size) + M[j, 2]
                w += (side[m, 0, j] + side[m, 1, j] + side[m, 2, j]) * ray[j]
                length += ray[j] * ray[j]
            depth[v, u] = (ray[2] if forward else np.sqrt(length)) / w
            label[v, u] = labels[m]
