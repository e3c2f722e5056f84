"""What a depth image tells of the target: the plane that it lies in."""

from __future__ import annotations

import cv2
import numpy as np

from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.undistortion import CameraModel

MIN_PIXELS = 12  # pixels with a depth, below which no plane is fitted


def fit_plane(depth: np.ndarray, camera: CameraModel, outline: np.ndarray | None) -> Plane | None:
    """The plane 1/Z = A x + B y + C with the least squared error in 1/Z over the target's pixels.

    Args:
        depth: (rows, columns), m along the optical axis; 0 or not finite: unknown.
        camera: its intrinsics.
        around: points (n, 2) of the target, normalised; pixels within their convex hull count.
            None: all pixels do.

    Returns:
        None where fewer than LEAST of those pixels have a depth.
    """
    known = np.isfinite(depth) & (depth > 0.0)
    if outline is not None:
        pixels = np.stack(camera.project(*np.asarray(outline, float).T), axis=1)
        hull = np.round(cv2.convexHull(pixels.astype(np.float32))).astype(np.int32)
        inside = np.zeros(depth.shape, np.uint8)
        cv2.fillConvexPoly(inside, hull, 1)
        known &= inside.astype(bool)
    row, column = np.nonzero(known)
    x, y, valid = camera.normalise(column, row)
    if valid.sum() < MIN_PIXELS:
        return None
    rays = np.column_stack([x, y, np.ones(len(x))])[valid]
    nearness = 1.0 / depth[row, column][valid].astype(float)
    return Plane(*np.linalg.lstsq(rays, nearness, rcond=None)[0].tolist())
