"""Base class of trackers that fit straight lines to profiles of grey levels."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ..undistortion import CameraModel
from .base import Tracker

OUTLIER_DISTANCE = 1.0  # px; points farther from a line do not belong to it


class EdgeTracker(Tracker):
    """Base class of trackers of straight lines; subclasses implement `find_normalised`."""

    def find(self, grey: NDArray[np.uint8]) -> np.ndarray:
        """Find the points, as `Tracker.find` does, in an image without lens distortion."""
        rows, columns = grey.shape
        return self.find_normalised(grey, CameraModel(columns, rows, (1, 0, 0, 0, 1, 0, 0, 0, 1)))

    @staticmethod
    def _sample_profiles(
        grey: np.ndarray, camera: CameraModel, scale: float, stations: np.ndarray,
        normal: np.ndarray, across: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """Return the grey levels (n, m) of profiles across a line.

        A profile has samples at the distances `across` (m,) along the normal from a station, (n,
        2).

        Positions are in px of the undistorted image; `scale` px are a normalised length of 1.
        """
        places = stations[:, None] + across[:, None] * normal
        u, v = camera.project(*(places.reshape(-1, 2).T / scale))
        return _interpolate(grey, u, v).reshape(places.shape[:2])

    @staticmethod
    def _is_near(points: np.ndarray, x: float, y: float, dx: float, dy: float) -> np.ndarray:
        """Return a mask of the points (n, 2), px, near the line through (x, y) along (dx, dy)."""
        return np.abs((points - (x, y)) @ (-dy, dx)) < OUTLIER_DISTANCE

    @staticmethod
    def _fit_robust_line(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Fit a line to points (n, 2), px, without outliers; return a point and the direction (2,).
        """
        middle = points.mean(axis=0)
        dx, dy, x, y = _fit_line(points - middle, cv2.DIST_HUBER)
        near = EdgeTracker._is_near(points - middle, x, y, dx, dy)
        if near.sum() > 1:  # Huber's fit stops some hundredths of a pixel too early
            dx, dy, x, y = _fit_line((points - middle)[near], cv2.DIST_L2)
        return middle + (x, y), np.array([dx, dy])

    @staticmethod
    def _intersect_lines(lines: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
        """Return the intersections (n, 2) of each line (point, direction) with the one before it.
        """
        homogeneous = np.array([(-dy, dx, x * dy - y * dx) for (x, y), (dx, dy) in lines])
        crossings = np.cross(np.roll(homogeneous, 1, axis=0), homogeneous)
        return crossings[:, :2] / crossings[:, 2:]


def _interpolate(grey: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Interpolate grey levels (n,) bilinearly at pixels (u, v) (n,).

    OpenCV's interpolation has a resolution of 1/32 px only.
    """
    rows, columns = grey.shape
    u, v = np.clip(u, 0.0, columns - 1.0), np.clip(v, 0.0, rows - 1.0)
    i, j = np.minimum(u.astype(int), columns - 2), np.minimum(v.astype(int), rows - 2)
    right, down = u - i, v - j
    above = grey[j, i] * (1.0 - right) + grey[j, i + 1] * right
    below = grey[j + 1, i] * (1.0 - right) + grey[j + 1, i + 1] * right
    return above * (1.0 - down) + below * down


def _fit_line(points: np.ndarray, kind: int) -> np.ndarray:
    """Fit a line to points (n, 2) with OpenCV; return dx, dy, x, y."""
    return cv2.fitLine(points.astype(np.float32), kind, 0.0, 1e-4, 1e-4).ravel().astype(float)
