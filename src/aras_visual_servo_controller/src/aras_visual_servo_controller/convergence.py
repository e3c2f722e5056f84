"""When the goal counts as reached."""

from __future__ import annotations

from collections import deque

import numpy as np

# A converged loop forgives half a tolerance more before it counts as away again.
FORGIVEN = 1.5
# Errors may scatter about their mean by so many tolerances (noise of the picture), in rms: more
# is a motion.
SCATTER = 3.0
ROUNDING = 1e-9  # s


class Convergence:
    """Judges the mean of the measured error over `hold` seconds; with hysteresis."""

    def __init__(self, hold: float) -> None:
        """`hold`: s; 0: every image is judged by itself."""
        self.hold = float(hold)
        self.clear()

    def clear(self) -> None:
        """Forget what was seen: the loop was interrupted."""
        self._seen: deque[tuple[float, np.ndarray]] = deque()
        self.reached = False

    def add(self, stamp: float, error: np.ndarray, tolerances: np.ndarray) -> bool:
        """Whether the goal counts as reached, with this image's error (k,) and tolerances (k,)."""
        if self._seen and len(self._seen[-1][1]) != len(error):
            self.clear()
        self._seen.append((stamp, np.array(error, float)))
        # One image at or before the window's beginning stays, to know that it is full.
        while len(self._seen) > 1 and self._seen[1][0] <= stamp - self.hold + ROUNDING:
            self._seen.popleft()
        if stamp - self._seen[0][0] < self.hold - ROUNDING:
            return False
        limit = np.asarray(tolerances, float) * (FORGIVEN if self.reached else 1.0)
        errors = np.array([e for _, e in self._seen])
        mean = errors.sum(axis=0) / len(errors)
        self.reached = bool((np.abs(mean) < limit).all())
        if self.reached:
            spread = np.square(errors - mean).sum(axis=0) / len(errors)
            self.reached = bool((spread < (SCATTER * limit) ** 2).all())
        return self.reached
