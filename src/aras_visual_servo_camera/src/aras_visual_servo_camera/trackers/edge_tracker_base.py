"""Base class of trackers that fit straight lines to edges.

An edge is measured on profiles, which are grey levels along short lines across the edge.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ..camera_model import CameraModel
from .base import Tracker

OUTLIER_DISTANCE = 1.0  # px; points farther from a fitted line are outliers


class EdgeTrackerBase(Tracker):
    """Base class of trackers that fit lines; a subclass implements `find_normalised`."""

    def find(self, grey: NDArray[np.uint8]) -> np.ndarray:
        """Find the points (n, 2), px, in an image (rows, columns) without lens distortion."""
        rows, columns = grey.shape
        return self.find_normalised(grey, CameraModel(columns, rows, (1, 0, 0, 0, 1, 0, 0, 0, 1)))

    @staticmethod
    def _sample_profiles(
        grey: np.ndarray, camera: CameraModel, scale: float, stations: np.ndarray,
        normal: np.ndarray, across: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """Sample n profiles across a line.

        Args:
            grey: (rows, columns) image.
            camera: intrinsics and distortion.
            scale: px of the undistorted image per normalised length of 1.
            stations: (n, 2) points on the line, one for each profile, px of the undistorted image.
            normal: (2,) unit normal of the line.
            across: (m,) distances of the samples from a station along the normal, px.

        Returns:
            (n, m) grey levels.
        """
        places = stations[:, None] + across[:, None] * normal
        u, v = camera.project(*(places.reshape(-1, 2).T / scale))
        return _interpolate(grey, u, v).reshape(places.shape[:2])

    @staticmethod
    def _is_near(points: np.ndarray, x: float, y: float, dx: float, dy: float) -> np.ndarray:
        """Return which of the points (n, 2), px, are near the line through (x, y) along (dx, dy).
        """
        return np.abs((points - (x, y)) @ (-dy, dx)) < OUTLIER_DISTANCE

    @staticmethod
    def _fit_robust_line(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Fit a line to those points (n, 2), px, that are not outliers.

        Returns:
            A point (2,) on the line, px, and its direction (2,), a unit vector.
        """
        middle = points.mean(axis=0)
        dx, dy, x, y = _fit_line(points - middle, cv2.DIST_HUBER)
        near = EdgeTrackerBase._is_near(points - middle, x, y, dx, dy)
        # Outliers displace the line of the first fit (Huber's loss) by some hundredths of a pixel.
        # The second fit (least squares) therefore uses no outliers.
        if near.sum() > 1:
            dx, dy, x, y = _fit_line((points - middle)[near], cv2.DIST_L2)
        return middle + (x, y), np.array([dx, dy])

    @staticmethod
    def _intersect_lines(lines: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
        """Return the intersection (n, 2) of each line with the line before it.

        lines: n pairs of a point (2,) on the line and its direction (2,).
        """
        homogeneous = np.array([(-dy, dx, x * dy - y * dx) for (x, y), (dx, dy) in lines])
        crossings = np.cross(np.roll(homogeneous, 1, axis=0), homogeneous)
        return crossings[:, :2] / crossings[:, 2:]


def _interpolate(grey: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Interpolate the grey levels (n,) of an image bilinearly at (u, v), (n,) each, px.

    OpenCV's interpolation is not used, because its coordinates have a resolution of 1/32 px.
    """
    rows, columns = grey.shape
    u, v = np.clip(u, 0.0, columns - 1.0), np.clip(v, 0.0, rows - 1.0)
    i, j = np.minimum(u.astype(int), columns - 2), np.minimum(v.astype(int), rows - 2)
    right, down = u - i, v - j
    above = grey[j, i] * (1.0 - right) + grey[j, i + 1] * right
    below = grey[j + 1, i] * (1.0 - right) + grey[j + 1, i + 1] * right
    return above * (1.0 - down) + below * down


def _fit_line(points: np.ndarray, kind: int) -> np.ndarray:
    """Fit a line to points (n, 2) with OpenCV.

    kind: OpenCV's code of the distance that is minimised.

    Returns:
        dx, dy of the direction, and x, y of a point on the line.
    """
    return cv2.fitLine(points.astype(np.float32), kind, 0.0, 1e-4, 1e-4).ravel().astype(float)
