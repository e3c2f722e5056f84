"""When the goal counts as reached."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_camera.compiled import MATRIX, VECTOR, compiled

from .recent import RecentErrors

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
        self._seen = RecentErrors()
        self.clear()

    def clear(self) -> None:
        """Forget what was seen: the loop was interrupted."""
        self._seen.clear()
        self.reached = False

    def add(self, stamp: float, error: np.ndarray, tolerances: np.ndarray) -> bool:
        """Whether the goal counts as reached, with this image's error (k,) and tolerances (k,)."""
        seen = self._seen
        if len(seen) and seen.errors.shape[1] != len(error):
            self.clear()
        seen.add(stamp, error)
        # One image at or before the window's beginning stays, to know that it is full.
        before = int(np.searchsorted(seen.stamps, stamp - self.hold + ROUNDING, "right"))
        seen.drop(max(before - 1, 0))
        if stamp - seen.stamps[0] < self.hold - ROUNDING:
            return False
        limit = np.asarray(tolerances, float) * (FORGIVEN if self.reached else 1.0)
        self.reached = _settled(seen.errors, limit)
        return self.reached


@compiled(MATRIX, VECTOR)
def _settled(errors, limit):
    """Whether errors (m, k) have means within the limits (k,) and scatter little about them."""
    count = errors.shape[0]
    for k in range(errors.shape[1]):
        mean, square = 0.0, 0.0
        for i in range(count):
            mean += errors[i, k]
        mean /= count
        for i in range(count):
            square += (errors[i, k] - mean) ** 2
        if not (abs(mean) < limit[k] and square / count < (SCATTER * limit[k]) ** 2):
            return False
    return True
