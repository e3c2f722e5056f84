"""Base class of control laws, which compute the desired rate of each error."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np

from aras_visual_servo_base.registry import Registry
from aras_visual_servo_base.settings import check, parameter

from ..errors import ConfigurationError

# Largest accepted gain, 1/s. A higher gain probably has a wrong unit: at 30 images per second the
# loop already oscillates with a gain of 60 1/s.
MAX_GAIN = 1000.0


def gain(default: float, help: str = "decay rate of the error") -> Any:
    """Declare a parameter of a law that is a gain, 1/s."""
    return parameter(default, "1/s", above=0.0, most=MAX_GAIN, help=help)


@dataclass(eq=False)
class Law(ABC):
    """Base class of control laws, which map the error to its desired rate.

    With the error e = s - s*, the law is a function e_dot = f(e, L, t), such as e_dot = -gain e.
    The camera twist v is then computed from L v = e_dot in the least-squares sense.

    A subclass implements `desired_error_rate`. Every law is a dataclass. Its parameters are
    annotated attributes, such as `gain: float = 5.0`, or are declared with unit and bounds by
    `parameter`. Parameters of type float can be changed while the law runs, also by
    dynamic_reconfigure. A law that stores state between images clears it in `reset`, which is also
    called after construction.

    Source: F. Chaumette and S. Hutchinson, Visual servo control, part I, IEEE Robotics and
    Automation Magazine 13(4), 2006.

    Attributes:
        name: short name of the law, for messages.
    """

    name: ClassVar[str] = ""

    def __init_subclass__(cls, **options: Any) -> None:
        """Turn each subclass into a dataclass; until it is registered, its name is the class name.
        """
        super().__init_subclass__(**options)
        cls.name = cls.__name__
        dataclass(eq=False)(cls)

    def __post_init__(self) -> None:
        self.check()
        self.reset()

    @abstractmethod
    def desired_error_rate(
        self,
        error: np.ndarray,
        L: np.ndarray,
        pseudo_inverse_error: np.ndarray,
        t: float,
        dt: float,
    ) -> np.ndarray:
        """Compute the desired rate of the error, e_dot (k,), in units of e per second.

        Args:
            error: (k,) error e = s - s*.
            L: (k, 6) interaction matrix; columns of directions that the scheme does not control are
                0.
            pseudo_inverse_error: (6,) L^+ e, the error as a displacement of the camera in its own
                frame, m and rad.
            t: time since servoing started, or restarted after the target was lost, s.
            dt: time since the previous image, s; 0.0 for the first image.
        """

    def reset(self) -> None:  # noqa: B027 - a law without state needs no reset
        """Clear integrals and other state that the law stores between images."""

    def check(self) -> None:
        """Raise an error for parameters that are out of bounds or do not fit together.

        Raises:
            ConfigurationError: a parameter is wrong; the message names it, its value and what is
                allowed.
        """
        check(self, ConfigurationError, f"law {self.name}: ")

    def list_tunable_parameters(self) -> dict[str, float]:
        """Return the parameters that may be changed while the law runs, by name."""
        own = {field.name: getattr(self, field.name) for field in fields(self) if field.init}
        return {name: value for name, value in own.items() if isinstance(value, float)}

    def set_parameters(self, **parameters: float) -> None:
        """Change the named parameters, also while the law runs.

        Raises:
            ConfigurationError: a value is not valid; all parameters then keep their old values.
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
