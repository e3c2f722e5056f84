"""Laws by name."""

from __future__ import annotations

from aras_visual_servo_base.lazy import LazyClasses
from aras_visual_servo_base.names import construct, find_class

from ..errors import ConfigurationError
from .base import Law

LAWS = LazyClasses(__package__, {
    "proportional": ".proportional:Proportional",
    "adaptive": ".proportional:Adaptive",
    "diagonal": ".proportional:Diagonal",
    "pi": ".dynamic:ProportionalIntegral",
    "sliding_mode": ".dynamic:SlidingMode",
})  # fmt: skip


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
    if ramp == continuous_start == 0.0:
        return law
    from .wrappers import ContinuousStart, Ramp

    if ramp != 0.0:
        law = Ramp(law, ramp)
    return ContinuousStart(law, continuous_start) if continuous_start != 0.0 else law
