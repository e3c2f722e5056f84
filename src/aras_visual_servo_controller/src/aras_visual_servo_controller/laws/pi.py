"""The PI law: proportional and integral."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.settings import parameter

from .base import LAWS, Law, gain


@LAWS.register("pi")
class ProportionalIntegral(Law):
    """Proportional-integral law, de/dt = -gain e - integral * (integral of e dt).

    It follows a target of constant velocity without error; a proportional law lags behind by
    speed / gain. To prevent windup, each component of the integral term is limited to `bound` times
    `gain` times the largest error so far.
    """

    gain: float = gain(5.0)
    integral: float = parameter(2.0, "1/s^2", above=0.0, help="gain of the integral")
    bound: float = parameter(
        1.0, above=0.0, help="maximum ratio of the integral term to the proportional term"
    )

    def reset(self) -> None:
        """Clear the state that the law stores between images."""
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
        """Compute the desired rate of the error, e_dot (k,)."""
        if self._error_integral is None or self._error_integral.shape != error.shape:
            self._error_integral = np.zeros_like(error)
            self._largest_error = np.abs(error)
        self._largest_error = np.maximum(self._largest_error, np.abs(error))
        most = self.bound * self.gain / self.integral * self._largest_error
        self._error_integral = np.clip(self._error_integral + error * dt, -most, most)
        return -self.gain * error - self.integral * self._error_integral
