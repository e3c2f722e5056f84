"""What a law is: how fast each error should shrink."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np

from aras_visual_servo_base.registry import Registry
from aras_visual_servo_base.settings import check, parameter

from ..errors import ConfigurationError

# Above this a gain is a mistake of units: at 30 images a second 60/s already rings.
GREATEST_GAIN = 1000.0


def gain(default: float, help: str = "decay rate of the error") -> Any:
    """Return the declaration of a parameter that is a gain, 1/s."""
    return parameter(default, "1/s", above=0.0, most=GREATEST_GAIN, help=help)


@dataclass(eq=False)
class Law(ABC):
    """A control law: it maps the error to the error's desired rate. Base class of all laws.

    A subclass gives `rate`. Its parameters are annotated attributes, `gain: float = 5.0`, or are
    declared with unit and bounds by `settings.parameter`: every law is a dataclass. Numbers may be
    changed while the law runs, also by dynamic_reconfigure. State that the law keeps between images
    is cleared by `reset`.

    Attributes:
        name: short name, for messages.
    """

    name: ClassVar[str] = ""

    def __init_subclass__(cls, **options: Any) -> None:
        """Make a dataclass of every law, and name it after its class unless it is registered."""
        super().__init_subclass__(**options)
        cls.name = cls.__name__
        dataclass(eq=False)(cls)

    def __post_init__(self) -> None:
        self.check()
        self.reset()

    @abstractmethod
    def rate(
        self,
        error: np.ndarray,
        L: np.ndarray,
        rotated_error: np.ndarray,
        t: float,
        dt: float,
    ) -> np.ndarray:
        """Return the desired rate of the error (k,), 1/s times its unit.

        Args:
            error: (k,) s - s*.
            L: (k, 6) interaction matrix of the modelled directions, zero in the others.
            rotated_error: (6,) L^+ error, m and rad of the camera.
            t: s since servoing began, or began again after the target was lost.
            dt: s since the previous image; 0.0 for the first.
        """

    def reset(self) -> None:  # noqa: B027 - a law without state has nothing to forget
        """Forget integrals and the time of the start."""

    def check(self) -> None:
        """Refuse parameters that are out of bounds, or do not go together.

        Raises:
            ConfigurationError: naming the parameter, its value and what would be right.
        """
        check(self, ConfigurationError, f"law {self.name}: ")

    def numbers(self) -> dict[str, float]:
        """Return the parameters that may be changed while the law runs, by name."""
        own = {field.name: getattr(self, field.name) for field in fields(self) if field.init}
        return {name: value for name, value in own.items() if isinstance(value, float)}

    def change(self, **parameters: float) -> None:
        """Change parameters, also while the law runs; those that are not named stay.

        Raises:
            ConfigurationError: as `check`; all are as they were then.
        """
        before = {name: getattr(self, name) for name in parameters if hasattr(self, name)}
        try:
            for name, value in parameters.items():
                setattr(self, name, value)
            self.check()
        except ConfigurationError:
            for name, value in before.items():
                setattr(self, name, value)
            raise


LAWS = Registry("law", __package__, (Law,), ConfigurationError)
