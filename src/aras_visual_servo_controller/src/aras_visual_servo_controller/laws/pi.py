"""The PI law: proportional and integral."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.settings import parameter

from .base import LAWS, Law, gain


@LAWS.register("pi")
class ProportionalIntegral(Law):
    """de/dt = -gain e - integral * (integral of e dt), the integral's part bounded.

    It follows a target that moves steadily, where a proportional law stays behind by speed / gain.
    Each component of the integral's part is at most `bound` times `gain` times the largest error
    so far, so that it does not wind up.
    """

    gain: float = gain(5.0)
    integral: float = parameter(2.0, "1/s^2", above=0.0, help="gain of the integral")
    bound: float = parameter(1.0, above=0.0, help="largest integral part over the proportional one")

    def reset(self) -> None:
        """See Law.reset."""
        self._error_integral: np.ndarray | None = None
        self._largest_error: np.ndarray | None = None

    def desired_error_rate(
        self,
        error: np.ndarray,
        L: np.ndarray,
        pseudo_inverse_error: np.ndarray,
        t: float,
        dt: float,
    ) -> np.ndarray:
        """See Law.rate."""
        if self._error_integral is None or self._error_integral.shape != error.shape:
            self._error_integral = np.zeros_like(error)
            self._largest_error = np.abs(error)
        self._largest_error = np.maximum(self._largest_error, np.abs(error))
        most = self.bound * self.gain / self.integral * self._largest_error
        self._error_integral = np.clip(self._error_integral + error * dt, -most, most)
        return -self.gain * error - self.integral * self._error_integral
