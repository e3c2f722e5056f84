"""Construction of laws by name, with an optional smooth start."""

from __future__ import annotations

from .base import LAWS, Law


def create_law(
    name: str, /, continuous_start: float = 0.0, ramp: float = 0.0, **parameters: object
) -> Law:
    """Create a law from its short name or 'package.module:Class'.

    Args:
        name: name of the law, such as 'proportional' or 'pi'; LAWS contains all names.
        continuous_start: rate mu of a ContinuousStart that wraps the law, 1/s; 0 for none.
        ramp: time constant of a Ramp that wraps the law, s; 0 for none.
        parameters: parameters of the law.

    Raises:
        ConfigurationError: the law is unknown, or does not accept a parameter.
    """
    law = LAWS.create(name, **parameters)
    if ramp == continuous_start == 0.0:
        return law
    from .wrappers import ContinuousStart, Ramp

    if ramp != 0.0:
        law = Ramp(law, ramp)
    return ContinuousStart(law, continuous_start) if continuous_start != 0.0 else law
