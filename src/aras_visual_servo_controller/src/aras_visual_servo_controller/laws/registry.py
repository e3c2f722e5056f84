"""Make a law by its name, with a smooth start round it."""

from __future__ import annotations

from .base import LAWS, Law


def create_law(
    name: str, /, continuous_start: float = 0.0, ramp: float = 0.0, **parameters: object
) -> Law:
    """Return the law of a short name or of 'package.module:Class'.

    Args:
        name: such as 'proportional' or 'pi'; see LAWS for all.
        continuous_start: mu of a ContinuousStart round it, 1/s; 0 for none.
        ramp: time of a Ramp round it, s; 0 for none.
        parameters: of the law.

    Raises:
        ConfigurationError: unknown law, or a parameter that it refuses.
    """
    law = LAWS.create(name, **parameters)
    if ramp == continuous_start == 0.0:
        return law
    from .wrappers import ContinuousStart, Ramp

    if ramp != 0.0:
        law = Ramp(law, ramp)
    return ContinuousStart(law, continuous_start) if continuous_start != 0.0 else law
