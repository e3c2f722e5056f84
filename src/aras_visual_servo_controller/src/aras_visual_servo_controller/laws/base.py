"""What a law is: how fast each error should shrink."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from ..errors import ConfigurationError

# Above this a gain is a mistake of units: at 30 images a second 60/s already rings.
GREATEST_GAIN = 1000.0


class Law(ABC):
    """From the error to its wanted rate; may keep state, which `reset` clears.

    Numbers that may be changed while it runs (by dynamic_reconfigure) are plain attributes named
    in `gains`; `change` sets them, `check` refuses bad ones.

    Attributes:
        title: of the law, for messages.
        greatest: of the numbers that have to be above 0, by name; inf: there is none.
    """

    gains: tuple[str, ...] = ()
    title: ClassVar[str] = ""
    greatest: ClassVar[Mapping[str, float]] = {}

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
        for name, most in self.greatest.items():
            check_gain(self.title, name, getattr(self, name), most)

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


def check_gain(owner: str, name: str, value: object, most: float = GREATEST_GAIN) -> None:
    """Raise ConfigurationError unless the value is a finite number above 0 and not above `most`."""
    number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not (number and np.isfinite(value) and value > 0.0):
        raise ConfigurationError(f"{owner}: {name} is {value!r}, it must be a number above 0")
    if value > most:
        raise ConfigurationError(
            f"{owner}: {name} is {value:g} 1/s, more than {most:g}: no camera is that fast (a gain "
            "of 5 settles within a second)"
        )
