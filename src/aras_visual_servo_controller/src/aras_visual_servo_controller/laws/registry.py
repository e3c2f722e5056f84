"""Laws by name."""

from __future__ import annotations

from aras_visual_servo_base.names import construct, find_class

from ..errors import ConfigurationError
from .base import Law
from .dynamic import ProportionalIntegral, SlidingMode
from .proportional import Adaptive, Diagonal, Proportional
from .wrappers import ContinuousStart, Ramp

LAWS: dict[str, type[Law]] = {
    "proportional": Proportional,
    "adaptive": Adaptive,
    "diagonal": Diagonal,
    "pi": ProportionalIntegral,
    "sliding_mode": SlidingMode,
}


def create_law(name: str, continuous_start: float = 0.0, ramp: float = 0.0, **gains: object) -> Law:
    """The law of a short name or of 'package.module:Class'.

    Args:
        name: see LAWS.
        continuous_start: mu of a ContinuousStart round it, 1/s; 0 for none.
        ramp: time of a Ramp round it, s; 0 for none.
        gains: arguments of the law's constructor.

    Raises:
        ConfigurationError: unknown law, or a gain that it refuses.
    """
    cls = find_class("law", name, LAWS, (Law,), ConfigurationError)
    law = construct("law", name, cls, ConfigurationError, **gains)
    if ramp != 0.0:
        law = Ramp(law, ramp)
    return ContinuousStart(law, continuous_start) if continuous_start != 0.0 else law
