"""Delivered depth: depth images within the range of a camera, and point clouds."""

from __future__ import annotations

import math

import numpy as np

from aras_visual_servo_base.compiled import jit

from ..description import DepthTopics

POINT_FLOATS = 8  # floats of a point in PCL's layout: x, y, z, padding, colour, padding (3)
COLOUR = 4  # index of the colour


def clip_depth(depth: np.ndarray, topics: DepthTopics) -> np.ndarray:
    """Return depth as (H, W) float32 in m with NaN, or uint16 in mm with 0, for invalid pixels.

    Depths outside the range of `topics` are invalid. The input is (H, W) float32, m, inf for pixels
    without a surface; with an infinite range, inf is not changed.
    """
    nothing = depth <= topics.nearest
    if topics.farthest < math.inf:
        nothing |= depth >= topics.farthest
    if topics.millimetres:
        thousands = np.where(nothing | (depth >= 65.5355), np.float32(0.0), depth * 1000.0)
        return thousands.astype(np.uint16)
    return np.where(nothing, np.float32(np.nan), depth) if nothing.any() else depth


class PointCloud:
    """Computes point clouds from the depth images of one camera."""

    def __init__(self, rays: np.ndarray, topics: DepthTopics) -> None:
        """Prepare for images with these rays, (H, W, 3) float32; see CameraSensor.compute_rays."""
        self._rays = rays
        self._topics = topics

    def compute_points(self, depth: np.ndarray, image: np.ndarray) -> np.ndarray:
        """Return (H, W, 8) float32: x, y, z in the optical frame, m; bytes blue, green, red, 0.

        Pixels without a surface, or outside the range (see `clip_depth`), are NaN.

        Args:
            depth: (H, W) float32, m.
            image: (H, W, 3) rgb, or (H, W) grey.
        """
        if image.dtype == np.uint16:
            image = (image >> 8).astype(np.uint8)
        if image.ndim == 2:
            image = np.repeat(image[..., None], 3, axis=2)
        points = np.zeros((*depth.shape, POINT_FLOATS), np.float32)
        _fill(self._rays, depth, np.ascontiguousarray(image),
              np.float32(self._topics.nearest), np.float32(self._topics.farthest), points,
              points.view(np.uint8))
        return points


@jit("f4[:,:,:], f4[:,:], u1[:,:,:], f4, f4, f4[:,:,::1], u1[:,:,::1]")
def _fill(rays, depth, image, nearest, farthest, points, data):
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            z = depth[v, u]
            if not nearest < z < farthest:
                z = np.float32(np.nan)
            for i in range(3):
                points[v, u, i] = rays[v, u, i] * z
                data[v, u, 16 + i] = image[v, u, 2 - i]
