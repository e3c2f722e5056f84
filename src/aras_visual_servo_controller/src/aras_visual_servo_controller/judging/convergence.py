"""When the goal counts as reached."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.compiled import compiled

from ..seeing.ring_buffer import RecentErrors
from .remaining_error import FORGIVEN, Standing

if TYPE_CHECKING:
    from ..schemes.base import Decision

# Errors may scatter about their mean by so many tolerances (noise of the picture), in rms: more
# is a motion.
SCATTER = 3.0
# Fewer images than this have no mean to be judged by: each of them has to be within its limits,
# and there have to be LEAST. Images that come seldom would else make a mean of a motion.
FEW, LEAST = 5, 3
ROUNDING = 1e-9  # s


class Convergence:
    """Judges the mean of the measured error over `hold` seconds; with hysteresis.

    Attributes:
        reached: the goal, as of the last image.
        short: why it is not, in words, where every feature alone would do; else empty.
    """

    def __init__(self, hold: float) -> None:
        """`hold`: s; 0: every image is judged by itself."""
        self.hold = float(hold)
        self._seen, self._standing = RecentErrors(), Standing()
        self.clear()

    def clear(self) -> None:
        """Forget what was seen: the loop was interrupted."""
        self._seen.clear()
        self._standing.clear()
        self.reached, self.short = False, ""

    def add(
        self,
        stamp: float,
        error: np.ndarray,
        tolerances: np.ndarray,
        decision: Decision | None = None,
        pose: np.ndarray | None = None,
    ) -> bool:
        """Whether the goal counts as reached, with this image's error (k,) and tolerances (k,).

        Args:
            decision: whose L tells how far that is for the camera, where it has one.
            pose: world_T_camera (4, 4) at the exposure, by kinematics; None: unknown.
        """
        seen, self.short = self._seen, ""
        if len(seen) and seen.errors.shape[1] != len(error):
            self.clear()
        seen.add(stamp, error)
        self._standing.add(stamp, error, tolerances, pose)
        # One image at or before the window's beginning stays, to know that it is full.
        before = int(np.searchsorted(seen.stamps, stamp - self.hold + ROUNDING, "right"))
        least = LEAST if self.hold > 0.0 else 1
        seen.drop(max(min(before - 1, len(seen) - least), 0))
        if len(seen) < least or stamp - seen.stamps[0] < self.hold - ROUNDING:
            return False
        limit = np.asarray(tolerances, float) * (FORGIVEN if self.reached else 1.0)
        settled = _settled(seen.errors, limit)
        if settled and len(seen) < FEW:
            settled = bool((np.abs(seen.errors) < limit).all())
        if settled and decision is not None:
            self.short = self._standing.short(decision, len(seen), self.reached)
        self.reached = settled and not self.short
        return self.reached


@compiled("f8[:,:], f8[:]")
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
