"""The sliding-mode law: proportional, with a bounded switch."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.settings import parameter

from ..errors import ConfigurationError
from .base import LAWS, MAX_GAIN, Law, gain


@LAWS.register("sliding_mode")
class SlidingMode(Law):
    """de/dt = -gain e - reach sat(e / width): arrives in finite time, rejects bounded disturbances.

    Within `width` of the goal the switch is a straight line, which avoids chatter.
    """

    gain: float = gain(5.0)
    reach: float = parameter(0.02, "1/s", above=0.0, help="rate of the switch, units of the error")
    width: float = parameter(0.01, above=0.0, help="boundary layer, units of the error")

    def check(self) -> None:
        """See Law.check."""
        super().check()
        steepest = self.gain + self.reach / self.width
        if steepest > MAX_GAIN:
            raise ConfigurationError(
                f"law {self.name}: gain + reach / width is {steepest:g} 1/s, must be <= "
                f"{MAX_GAIN:g} 1/s: raise width"
            )

    def desired_error_rate(
        self,
        error: np.ndarray,
        L: np.ndarray,
        pseudo_inverse_error: np.ndarray,
        t: float,
        dt: float,
    ) -> np.ndarray:
        """See Law.rate."""
        return -self.gain * error - self.reach * np.clip(error / self.width, -1.0, 1.0)
