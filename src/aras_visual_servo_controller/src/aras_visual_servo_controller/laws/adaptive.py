"""The adaptive law: the gain is higher near the goal."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.settings import parameter

from ..errors import ConfigurationError
from .base import LAWS, Law, gain


@LAWS.register("adaptive")
class Adaptive(Law):
    """Adaptive gain, which is high near the goal and low far from it (vpAdaptiveGain in ViSP).

    de/dt = -g(n) e, where n is the largest component of L^+ e (m and rad) and g(n) = (zero -
    infinity) exp(-slope n / (zero - infinity)) + infinity. The parameters `zero` and `infinity` are
    the gains at n = 0 and for large n; -slope is the derivative of g at n = 0.
    """

    zero: float = gain(5.0, "gain at the goal")
    infinity: float = gain(2.0, "gain far from the goal")
    slope: float = parameter(30.0, "1/(s m)", above=0.0, help="slope of the gain at the goal")

    def check(self) -> None:
        """Raise an error for parameters that are out of bounds or do not fit together."""
        super().check()
        if self.zero <= self.infinity:
            raise ConfigurationError(
                f"law {self.name}: the parameter zero is {self.zero:g} 1/s, must be greater than "
                f"the parameter infinity, {self.infinity:g} 1/s"
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
        span = self.zero - self.infinity
        size = float(np.abs(pseudo_inverse_error).max())
        return -(span * np.exp(-self.slope * size / span) + self.infinity) * error
