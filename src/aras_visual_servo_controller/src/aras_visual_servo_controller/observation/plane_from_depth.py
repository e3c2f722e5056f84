"""Plane of the target from a depth image."""

from __future__ import annotations

import cv2
import numpy as np

from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.interaction import Plane

MIN_PIXELS = 12  # smallest number of pixels with a known depth to which a plane is fitted


def fit_plane(depth: np.ndarray, camera: CameraModel, outline: np.ndarray | None) -> Plane | None:
    """Fit the plane 1/Z = A x + B y + C to the target's pixels, by least squares in 1/Z.

    Args:
        depth: (rows, columns) depth along the optical axis, m; 0 or not finite if it is unknown.
        camera: intrinsics of the camera.
        outline: (n, 2) points of the target, normalised. The pixels within their convex hull are
            used; None to use all pixels.

    Returns:
        The plane, or None if fewer than MIN_PIXELS of these pixels have a depth.
    """
    is_used = np.isfinite(depth) & (depth > 0.0)
    if outline is not None:
        pixels = np.stack(camera.project(*np.asarray(outline, float).T), axis=1)
        hull = np.round(cv2.convexHull(pixels.astype(np.float32))).astype(np.int32)
        inside = np.zeros(depth.shape, np.uint8)
        cv2.fillConvexPoly(inside, hull, 1)
        is_used &= inside.astype(bool)
    row, column = np.nonzero(is_used)
    x, y, valid = camera.normalise(column, row)
    if valid.sum() < MIN_PIXELS:
        return None
    rays = np.column_stack([x, y, np.ones(len(x))])[valid]
    inverse_depth = 1.0 / depth[row, column][valid].astype(float)
    return Plane(*np.linalg.lstsq(rays, inverse_depth, rcond=None)[0].tolist())
