"""Joint positions by stamp, so that an image meets the joints of its own instant.

Images and joint states come over different connections. Where runs have to repeat bit by bit
(lockstep), an image is answered with the joints measured last before its exposure, not with those
that happened to arrive first.
"""

from collections import deque

import numpy as np


class JointHistory:
    """The last few joint positions (6,), rad or m, with their stamps in s."""

    def __init__(self, length: int = 16) -> None:
        """`length`: samples to keep."""
        self._samples: deque[tuple[float, np.ndarray]] = deque(maxlen=length)

    def add(self, stamp: float, positions: np.ndarray) -> None:
        """Note positions measured at `stamp`; stamps have to rise."""
        self._samples.append((stamp, positions))

    def clear(self) -> None:
        """Forget all, as after a reset of the clock."""
        self._samples.clear()

    def complete_to(self, stamp: float) -> bool:
        """Whether no sample up to `stamp` can still be on its way, going by the samples' period.

        False with fewer than two samples, which tell no period.
        """
        if len(self._samples) < 2:
            return False
        newest, before = self._samples[-1][0], self._samples[-2][0]
        return newest + (newest - before) > stamp

    def at(self, stamp: float) -> np.ndarray | None:
        """Positions of the last sample at or before `stamp`; None where there is none."""
        return next((q for t, q in reversed(self._samples) if t <= stamp), None)
