"""Measurement of the real-time factor."""

from __future__ import annotations

from collections import deque


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
