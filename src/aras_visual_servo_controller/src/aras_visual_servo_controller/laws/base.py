"""What a law is: how fast each error should shrink."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from ..errors import ConfigurationError


class Law(ABC):
    """From the error to its wanted rate; may keep state, which `reset` clears.

    Numbers that may be changed while it runs (by dynamic_reconfigure) are plain attributes named
    in `gains`; `change` sets them, `check` refuses bad ones.
    """

    gains: tuple[str, ...] = ()

    @abstractmethod
    def rate(
        self,
        error: np.ndarray,
        L: np.ndarray,
        rotated_error: np.ndarray,
        t: float,
        dt: float,
    ) -> np.ndarray:
        """The wanted rate of the error (k,), 1/s times its unit.

        Args:
            error: (k,) s - s*.
            L: (k, 6) interaction matrix of the modelled directions, zero in the others.
            rotated_error: (6,) L^+ error, m and rad of the camera.
            t: s since servoing began, or began again after the target was lost.
            dt: s since the previous image; 0.0 for the first.
        """

    def reset(self) -> None:
        """Begin anew: forget integrals and the time of the start."""

    def check(self) -> None:
        """Refuse gains that cannot be, also those that do not go together.

        Raises:
            ConfigurationError: naming the gain, its value and what would be right.
        """

    def change(self, **gains: float) -> None:
        """Take other gains, also while it runs; those that are not named stay.

        Raises:
            ConfigurationError: as `check`; all are as they were then.
        """
        before = {name: getattr(self, name) for name in gains if hasattr(self, name)}
        try:
            for name, value in gains.items():
                setattr(self, name, value)
            self.check()
        except ConfigurationError:
            for name, value in before.items():
                setattr(self, name, value)
            raise
        for name, value in gains.items():
            setattr(self, name, float(value))


def positive(owner: str, **values: float) -> None:
    """Raise ConfigurationError unless every value is a finite number above 0."""
    for name, value in values.items():
        number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
        if not (number and np.isfinite(value) and value > 0.0):
            raise ConfigurationError(f"{owner}: {name} is {value!r}, it must be a number above 0")
