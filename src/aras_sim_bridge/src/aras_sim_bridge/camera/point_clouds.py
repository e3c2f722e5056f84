"""Depth images with a limited range, and point clouds, as a camera delivers them."""

from __future__ import annotations

import math

import numpy as np

from aras_visual_servo_base.compiled import jit

from ..description import DepthDescription

# Number of floats per point, as in PCL: x, y, z, one unused, colour, and three unused.
POINT_FLOATS = 8
COLOUR = 4  # index of the colour among the floats of a point


def clip_depth(depth: np.ndarray, topics: DepthDescription) -> np.ndarray:
    """Mark the pixels of a depth image that are outside the range of the camera.

    Args:
        depth: (H, W) float32, m; inf for pixels without a surface.
        topics: range and unit of the delivered depth.

    Returns:
        Depth (H, W): either float32 in m, with NaN for pixels outside the range, or uint16 in mm,
        with 0 for these pixels. If the range has no upper bound, float32 images retain inf.
    """
    nothing = depth <= topics.nearest
    if topics.farthest < math.inf:
        nothing |= depth >= topics.farthest
    if topics.millimetres:
        thousands = np.where(nothing | (depth >= 65.5355), np.float32(0.0), depth * 1000.0)
        return thousands.astype(np.uint16)
    return np.where(nothing, np.float32(np.nan), depth) if nothing.any() else depth


def compute_points(
    rays: np.ndarray, depth: np.ndarray, image: np.ndarray, topics: DepthDescription
) -> np.ndarray:
    """Return the points (H, W, 8) float32 of all pixels of a depth image.

    The first three numbers are x, y, z in the optical frame, m. They are NaN for pixels that have
    no surface or are outside the range. The number at index COLOUR contains the bytes blue, green,
    red and 0.

    Args:
        rays: (H, W, 3) float32, result of CameraSensor.compute_rays.
        depth: depth image (H, W) float32, m.
        image: colour image (H, W, 3) rgb, or grey image (H, W).
        topics: range of the delivered depth.
    """
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    if image.ndim == 2:
        image = np.repeat(image[..., None], 3, axis=2)
    points = np.zeros((*depth.shape, POINT_FLOATS), np.float32)
    _fill(rays, depth, np.ascontiguousarray(image), np.float32(topics.nearest),
          np.float32(topics.farthest), points, points.view(np.uint8))
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
