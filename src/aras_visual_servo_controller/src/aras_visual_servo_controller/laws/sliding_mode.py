"""The sliding-mode law: proportional, with a bounded switching term."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.settings import parameter

from ..errors import ConfigurationError
from .base import LAWS, MAX_GAIN, Law, gain


@LAWS.register("sliding_mode")
class SlidingMode(Law):
    """Sliding mode, de/dt = -gain e - reach sat(e / width), which rejects bounded disturbances.

    Here sat limits its argument to -1 ... 1. The switching term, with the factor `reach`, brings
    the error to |e| <= `width` in finite time. For smaller errors it is proportional to e, which
    avoids chatter.
    """

    gain: float = gain(5.0)
    reach: float = parameter(
        0.02, "1/s", above=0.0, help="rate of the switching term, in units of the error"
    )
    width: float = parameter(0.01, above=0.0, help="boundary layer, units of the error")

    def check(self) -> None:
        """Raise an error for parameters that are out of bounds or do not fit together."""
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
        """Compute the desired rate of the error, e_dot (k,)."""
        return -self.gain * error - self.reach * np.clip(error / self.width, -1.0, 1.0)
