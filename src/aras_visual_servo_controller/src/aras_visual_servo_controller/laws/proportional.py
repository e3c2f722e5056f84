"""Laws without memory: constant, adaptive, and one gain a feature.

Reference: F. Chaumette and S. Hutchinson, Visual servo control, part I, IEEE Robotics and
Automation Magazine 13(4), 2006.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import ConfigurationError
from .base import GREATEST_GAIN, Law, check_gain


class Proportional(Law):
    """e_dot = -gain e: every feature decays as exp(-gain t). gain in 1/s."""

    gains, title = ("gain",), "proportional law"
    greatest = {"gain": GREATEST_GAIN}

    def __init__(self, gain: float = 5.0) -> None:
        self.change(gain=gain)

    def rate(
        self, error: np.ndarray, L: np.ndarray, rotated_error: np.ndarray, t: float, dt: float
    ) -> np.ndarray:
        """See Law.rate."""
        return -self.gain * error


class Adaptive(Law):
    """High gain near the goal, low far from it (ViSP's vpAdaptiveGain).

    e_dot = -g(n) e,  g(n) = (zero - infinity) exp(-slope n / (zero - infinity)) + infinity, with
    n the largest component of L^+ e (m and rad). zero, infinity in 1/s, slope in 1/s per unit.
    """

    gains, title = ("zero", "infinity", "slope"), "adaptive law"
    greatest = {"zero": GREATEST_GAIN, "infinity": GREATEST_GAIN, "slope": np.inf}

    def __init__(self, zero: float = 5.0, infinity: float = 2.0, slope: float = 30.0) -> None:
        self.change(zero=zero, infinity=infinity, slope=slope)

    def check(self) -> None:
        """See Law.check."""
        super().check()
        if self.zero <= self.infinity:
            raise ConfigurationError(
                f"adaptive law: gain at zero {self.zero} must exceed the one at infinity "
                f"{self.infinity}"
            )

    def rate(
        self, error: np.ndarray, L: np.ndarray, rotated_error: np.ndarray, t: float, dt: float
    ) -> np.ndarray:
        """See Law.rate."""
        span = self.zero - self.infinity
        size = float(np.abs(rotated_error).max())
        return -(span * np.exp(-self.slope * size / span) + self.infinity) * error


class Diagonal(Law):
    """e_dot_i = -values_i e_i: one constant gain a feature, 1/s; the laboratory's Lambda."""

    gains = ("values",)

    def __init__(self, values: Sequence[float]) -> None:
        if not isinstance(values, Sequence | np.ndarray) or len(values) == 0:
            raise ConfigurationError(f"diagonal law: {values!r} must be a list of gains")
        for i, value in enumerate(values):
            check_gain("diagonal law", f"gain {i}", value)
        self.values = np.array(values, float)

    def rate(
        self, error: np.ndarray, L: np.ndarray, rotated_error: np.ndarray, t: float, dt: float
    ) -> np.ndarray:
        """See Law.rate.

        Raises:
            ConfigurationError: as many gains as features are needed.
        """
        if len(error) != len(self.values):
            raise ConfigurationError(
                f"diagonal law: {len(self.values)} gains for {len(error)} features"
            )
        return -self.values * error
