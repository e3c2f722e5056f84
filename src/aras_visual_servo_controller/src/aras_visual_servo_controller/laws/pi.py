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
        self._sum: np.ndarray | None = None
        self._greatest: np.ndarray | None = None

    def rate(
        self, error: np.ndarray, L: np.ndarray, rotated_error: np.ndarray, t: float, dt: float
    ) -> np.ndarray:
        """See Law.rate."""
        if self._sum is None or self._sum.shape != error.shape:
            self._sum = np.zeros_like(error)
            self._greatest = np.abs(error)
        self._greatest = np.maximum(self._greatest, np.abs(error))
        most = self.bound * self.gain / self.integral * self._greatest
        self._sum = np.clip(self._sum + error * dt, -most, most)
        return -self.gain * error - self.integral * self._sum
