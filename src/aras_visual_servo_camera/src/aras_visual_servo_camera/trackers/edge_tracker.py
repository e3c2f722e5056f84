"""What trackers of straight lines have in common: profiles across a line, and its fit."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ..undistortion import CameraModel
from .base import Tracker

OUTLIER_DISTANCE = 1.0  # px from a line beyond which a point is none of it


class EdgeTracker(Tracker):
    """Base of trackers that fit straight lines, which a lens bends: give `places`."""

    def find(self, grey: NDArray[np.uint8]) -> np.ndarray:
        """See Tracker.find; of a picture without a lens, or with the lens taken off."""
        rows, columns = grey.shape
        return self.find_normalised(grey, CameraModel(columns, rows, (1, 0, 0, 0, 1, 0, 0, 0, 1)))

    @staticmethod
    def _sample_profiles(
        grey: np.ndarray, camera: CameraModel, scale: float, stations: np.ndarray,
        normal: np.ndarray, across: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """Grey levels (n, m) at `across` (m,) along the normal (2,) from stations (n, 2); px of the
        picture without the lens, `scale` of them to a normalised length of 1."""
        places = stations[:, None] + across[:, None] * normal
        u, v = camera.project(*(places.reshape(-1, 2).T / scale))
        return _interpolate(grey, u, v).reshape(places.shape[:2])

    @staticmethod
    def _near(points: np.ndarray, x: float, y: float, dx: float, dy: float) -> np.ndarray:
        """Which of points (n, 2), px, lie at the line through (x, y) along (dx, dy)."""
        return np.abs((points - (x, y)) @ (-dy, dx)) < OUTLIER_DISTANCE

    @staticmethod
    def _fit_robust_line(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A point (2,) and the direction (2,) of the line through points (n, 2), px, but for those
        that lie off it."""
        middle = points.mean(axis=0)
        dx, dy, x, y = _fit_line(points - middle, cv2.DIST_HUBER)
        near = EdgeTracker._near(points - middle, x, y, dx, dy)
        if near.sum() > 1:  # Huber's fit ends some hundredths of a pixel early
            dx, dy, x, y = _fit_line((points - middle)[near], cv2.DIST_L2)
        return middle + (x, y), np.array([dx, dy])

    @staticmethod
    def _intersect_lines(lines: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
        """Where each line (point, direction) meets the one before it (n, 2)."""
        whole = np.array([(-dy, dx, x * dy - y * dx) for (x, y), (dx, dy) in lines])
        crossings = np.cross(np.roll(whole, 1, axis=0), whole)
        return crossings[:, :2] / crossings[:, 2:]


def _interpolate(grey: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Grey levels (n,) at pixels (u, v) (n,), bilinear; OpenCV knows only 32nds of a pixel."""
    rows, columns = grey.shape
    u, v = np.clip(u, 0.0, columns - 1.0), np.clip(v, 0.0, rows - 1.0)
    i, j = np.minimum(u.astype(int), columns - 2), np.minimum(v.astype(int), rows - 2)
    right, down = u - i, v - j
    above = grey[j, i] * (1.0 - right) + grey[j, i + 1] * right
    below = grey[j + 1, i] * (1.0 - right) + grey[j + 1, i + 1] * right
    return above * (1.0 - down) + below * down


def _fit_line(points: np.ndarray, kind: int) -> np.ndarray:
    """dx, dy, x, y of OpenCV's line through points (n, 2)."""
    return cv2.fitLine(points.astype(np.float32), kind, 0.0, 1e-4, 1e-4).ravel().astype(float)
