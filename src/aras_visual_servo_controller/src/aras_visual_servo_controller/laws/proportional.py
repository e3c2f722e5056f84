"""The proportional law: one constant gain."""

from __future__ import annotations

import numpy as np

from .base import LAWS, Law, gain


@LAWS.register("proportional")
class Proportional(Law):
    """Proportional law, de/dt = -gain e: every error decays as exp(-gain t).

    Source: F. Chaumette and S. Hutchinson, Visual servo control, part I, IEEE Robotics and
    Automation Magazine 13(4), 2006.
    """

    gain: float = gain(5.0)

    def desired_error_rate(
        self,
        error: np.ndarray,
        L: np.ndarray,
        pseudo_inverse_error: np.ndarray,
        t: float,
        dt: float,
    ) -> np.ndarray:
        """Compute the desired rate of the error, e_dot (k,)."""
        return -self.gain * error
