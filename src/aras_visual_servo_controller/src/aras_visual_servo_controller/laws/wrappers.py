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
        self._initial_motion: tuple[float, np.ndarray] | None = None  # time and rotated error

    def desired_error_rate(
        self,
        error: np.ndarray,
        L: np.ndarray,
        pseudo_inverse_error: np.ndarray,
        t: float,
        dt: float,
    ) -> np.ndarray:
        """See Law.rate."""
        if self._initial_motion is None:
            self._initial_motion = t, np.array(pseudo_inverse_error)
        began, first = self._initial_motion
        held = np.exp(-self.mu * max(t - began, 0.0)) * first
        return self.law.desired_error_rate(error - L @ held, L, pseudo_inverse_error, t, dt)


class Ramp(Law):
    """The wanted rate of the law inside, rising from 0 as 1 - exp(-t / time). time in s."""

    law: Law = parameter(internal=True)
    time: float = parameter(0.1, "s", above=0.0, help="time constant")

    def reset(self) -> None:
        """See Law.reset."""
        self.law.reset()
        self._start_time: float | None = None

    def desired_error_rate(
        self,
        error: np.ndarray,
        L: np.ndarray,
        pseudo_inverse_error: np.ndarray,
        t: float,
        dt: float,
    ) -> np.ndarray:
        """See Law.rate."""
        if self._start_time is None:
            self._start_time = t
        part = 1.0 - np.exp(-max(t - self._start_time, 0.0) / self.time)
        return part * self.law.desired_error_rate(error, L, pseudo_inverse_error, t, dt)
