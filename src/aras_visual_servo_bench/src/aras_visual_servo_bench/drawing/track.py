"""Curve of a moving point, and measurement of the real-time factor."""

from __future__ import annotations

from collections import deque

import numpy as np

# Largest number of points of a track. When a track has more, every second point is removed.
MAX_POINTS = 600


class Track:
    """Curve of a moving point. The number of its points is limited to MAX_POINTS."""

    def __init__(self, width: int, spacing: float) -> None:
        """Create an empty track.

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


class RealTimeFactor:
    """Ratio of simulated time to wall time, measured over the last WINDOW seconds of wall time."""

    # Length of the interval over which the real-time factor is measured, s of wall time.
    WINDOW = 2.0
    MIN_TIME = 0.3  # shortest interval from which the real-time factor is computed, s of wall time

    def __init__(self) -> None:
        self._samples: deque[tuple[float, float]] = deque()

    def add(self, wall_time: float, simulated_time: float) -> None:
        """Add the times of both clocks at one instant, s.

        If the simulated time jumps back, the measurement restarts.
        """
        if self._samples and simulated_time < self._samples[-1][1]:
            self._samples.clear()
        self._samples.append((wall_time, simulated_time))
        while wall_time - self._samples[0][0] > self.WINDOW:
            self._samples.popleft()

    @property
    def factor(self) -> float | None:
        """Real-time factor; None until it is known."""
        if not self._samples:
            return None
        (wall_0, simulated_0), (wall, simulated) = self._samples[0], self._samples[-1]
        if wall - wall_0 < self.MIN_TIME:
            return None
        return (simulated - simulated_0) / (wall - wall_0)
