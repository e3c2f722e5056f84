"""Laws round a law: a start without a jump of the speed."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.settings import parameter

from .base import Law


class ContinuousStart(Law):
    """The camera starts from rest, whatever its first error (ViSP's compensated start).

    The initial motion L^+ e(0) is subtracted and let decay as exp(-mu t):
    e' = e - L (L^+ e(0)) exp(-mu t) goes to the law inside. mu in 1/s. Reference: N. Mansard and
    F. Chaumette, Task sequencing for high-level sensor-based control, IEEE T-RO 23(1), 2007.
    """

    law: Law = parameter(internal=True)
    mu: float = parameter(4.0, "1/s", above=0.0, help="rate at which the first motion is let in")

    def reset(self) -> None:
        """See Law.reset."""
        self.law.reset()
        self._first: tuple[float, np.ndarray] | None = None  # time and rotated error

    def rate(
        self, error: np.ndarray, L: np.ndarray, rotated_error: np.ndarray, t: float, dt: float
    ) -> np.ndarray:
        """See Law.rate."""
        if self._first is None:
            self._first = t, np.array(rotated_error)
        began, first = self._first
        held = np.exp(-self.mu * max(t - began, 0.0)) * first
        return self.law.rate(error - L @ held, L, rotated_error, t, dt)


class Ramp(Law):
    """The wanted rate of the law inside, rising from 0 as 1 - exp(-t / time). time in s."""

    law: Law = parameter(internal=True)
    time: float = parameter(0.1, "s", above=0.0, help="time constant")

    def reset(self) -> None:
        """See Law.reset."""
        self.law.reset()
        self._began: float | None = None

    def rate(
        self, error: np.ndarray, L: np.ndarray, rotated_error: np.ndarray, t: float, dt: float
    ) -> np.ndarray:
        """See Law.rate."""
        if self._began is None:
            self._began = t
        part = 1.0 - np.exp(-max(t - self._began, 0.0) / self.time)
        return part * self.law.rate(error, L, rotated_error, t, dt)
