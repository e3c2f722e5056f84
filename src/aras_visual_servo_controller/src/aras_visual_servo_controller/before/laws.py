"""Control laws: from the error of the features to the velocity of the camera.

All of them are v = -gain * L^+ e; they differ in the gain. L (k, n) holds the columns of the
interaction matrix that may be used, e (k,) the error s - s*, v (n,) the velocities of the camera
in m/s and rad/s.

Reference: Chaumette and Hutchinson, Visual servo control, part I, 2006.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import ConfigurationError


def _positive(owner: str, **values: float) -> None:
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0.0):
            raise ConfigurationError(f"{owner}: {name} is {value}, it must be a number above 0")


class Law(ABC):
    """A gain, and how it depends on the error and on the time since the start."""

    @abstractmethod
    def gain(self, error: np.ndarray, elapsed: float) -> np.ndarray:
        """Gain (k,) in 1/s for an error (k,), elapsed s after servoing began."""

    def velocity(self, L: np.ndarray, error: np.ndarray, elapsed: float) -> np.ndarray:
        """v = -L^+ (gain * e), shape (n,)."""
        return -np.linalg.pinv(L) @ (self.gain(error, elapsed) * error)


@dataclass(frozen=True)
class Proportional(Law):
    """Constant gain: every feature decays as exp(-gain t).

    `ramp` (s) is the time constant with which the gain rises from 0 at the start, so that the arm
    is not asked to jump to full speed; 0 switches it off.
    """

    value: float = 3.0
    ramp: float = 0.0

    def __post_init__(self) -> None:
        _positive("proportional law", gain=self.value)
        if not (np.isfinite(self.ramp) and self.ramp >= 0.0):
            raise ConfigurationError(f"proportional law: ramp is {self.ramp}, it must be >= 0 s")

    def gain(self, error: np.ndarray, elapsed: float) -> np.ndarray:
        rise = 1.0 if self.ramp == 0.0 else 1.0 - np.exp(-max(elapsed, 0.0) / self.ramp)
        return np.full(len(error), self.value * rise)


@dataclass(frozen=True)
class Adaptive(Law):
    """High gain near the goal, low far from it (ViSP's vpAdaptiveGain):

    gain(x) = (zero - infinity) exp(-slope x / (zero - infinity)) + infinity, x = max |e_i|.
    """

    zero: float = 5.0
    infinity: float = 2.0
    slope: float = 30.0

    def __post_init__(self) -> None:
        _positive("adaptive law", zero=self.zero, infinity=self.infinity, slope=self.slope)
        if self.zero <= self.infinity:
            raise ConfigurationError(
                f"adaptive law: gain at zero {self.zero} must exceed the one at infinity "
                f"{self.infinity}"
            )

    def gain(self, error: np.ndarray, elapsed: float) -> np.ndarray:
        span = self.zero - self.infinity
        size = float(np.abs(error).max())
        return np.full(len(error), span * np.exp(-self.slope * size / span) + self.infinity)


@dataclass(frozen=True)
class Diagonal(Law):
    """One constant gain a feature, 1/s: the laboratory's Lambda."""

    values: Sequence[float]

    def __post_init__(self) -> None:
        _positive("diagonal law", **{f"gain {i}": v for i, v in enumerate(self.values)})

    def gain(self, error: np.ndarray, elapsed: float) -> np.ndarray:
        if len(error) != len(self.values):
            raise ConfigurationError(
                f"diagonal law: {len(self.values)} gains for {len(error)} features"
            )
        return np.asarray(self.values, float)
