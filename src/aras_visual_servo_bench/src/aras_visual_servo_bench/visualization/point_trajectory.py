"""Curve of a moving point."""

from __future__ import annotations

import numpy as np

# Largest number of points of a curve. When a curve has more, every second point is removed.
MAX_POINTS = 600


class PointTrajectory:
    """Curve of a moving point. The number of its points is limited to MAX_POINTS."""

    def __init__(self, width: int, spacing: float) -> None:
        """Create an empty curve.

        Args:
            width: number of coordinates of a point.
            spacing: smallest distance between a new point and the last point.
        """
        self._width, self._min_spacing = width, spacing
        self.clear()

    def clear(self) -> None:
        """Remove all points."""
        self._points: list[np.ndarray] = []
        self._spacing = self._min_spacing

    def add(self, point: np.ndarray) -> None:
        """Add a point (width,). It is ignored if it is not finite or too near to the last point."""
        point = np.array(point, float)
        if point.shape != (self._width,) or not np.isfinite(point).all():
            return
        if self._points and np.linalg.norm(point - self._points[-1]) < self._spacing:
            return
        self._points.append(point)
        if len(self._points) > MAX_POINTS:
            self._points = self._points[::2]
            gaps = np.linalg.norm(np.diff(self._points, axis=0), axis=1)
            self._spacing = max(2.0 * self._spacing, float(np.median(gaps)))

    @property
    def points(self) -> np.ndarray:
        """Points (n, width) of the curve."""
        return np.array(self._points).reshape(-1, self._width)
