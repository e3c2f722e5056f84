"""Laws with memory or a switch: PI and sliding mode."""

from __future__ import annotations

import numpy as np

from ..errors import ConfigurationError
from .base import GREATEST_GAIN, Law


class ProportionalIntegral(Law):
    """e_dot = -gain e - integral * (integral of e dt), the integral's part bounded.

    gain in 1/s, integral in 1/s^2. It follows a target that moves steadily, where a proportional
    law stays behind by speed / gain. Each component of the integral's part is bounded to
    `bound` times the proportional gain times the error's own start, no wind-up.
    """

    gains, title = ("gain", "integral"), "PI law"
    greatest = {"gain": GREATEST_GAIN, "integral": np.inf, "bound": np.inf}

    def __init__(self, gain: float = 4.0, integral: float = 2.0, bound: float = 1.0) -> None:
        self.change(gain=gain, integral=integral, bound=bound)
        self.reset()

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


class SlidingMode(Law):
    """e_dot = -gain e - reach sat(e / width): arrives in finite time, bounds disturbances.

    gain in 1/s, reach the rate of the switching part in units of the error per second, width the
    boundary layer in units of the error, within which the switch is a straight line (no chatter).
    """

    gains, title = ("gain", "reach", "width"), "sliding-mode law"
    greatest = {"gain": GREATEST_GAIN, "reach": np.inf, "width": np.inf}

    def __init__(self, gain: float = 3.0, reach: float = 0.02, width: float = 0.01) -> None:
        self.change(gain=gain, reach=reach, width=width)

    def check(self) -> None:
        """See Law.check."""
        super().check()
        steepest = self.gain + self.reach / self.width
        if steepest > GREATEST_GAIN:
            raise ConfigurationError(
                f"sliding-mode law: within its layer the gain is gain + reach / width = "
                f"{steepest:g} 1/s, more than {GREATEST_GAIN:g}: widen the layer"
            )

    def rate(
        self, error: np.ndarray, L: np.ndarray, rotated_error: np.ndarray, t: float, dt: float
    ) -> np.ndarray:
        """See Law.rate."""
        return -self.gain * error - self.reach * np.clip(error / self.width, -1.0, 1.0)
