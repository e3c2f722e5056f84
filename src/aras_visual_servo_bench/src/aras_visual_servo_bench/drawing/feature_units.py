"""Units of the features that a controller reports; they are found by the name of its scheme."""

from __future__ import annotations

from functools import lru_cache

from aras_visual_servo_controller.errors import ServoError
from aras_visual_servo_controller.settings import Settings


@lru_cache(maxsize=64)
def find_feature_units(scheme: str, count: int) -> tuple[str, ...]:
    """Return the unit of each feature of a scheme; '' for a feature without unit.

    The result is empty if the units are unknown: for a user's own scheme, which is not imported,
    and for a shipped scheme whose number of features is not `count`.
    """
    if ":" in scheme or not scheme:
        return ()
    try:
        units = tuple(Settings(scheme=scheme).make_scheme().units or ())
    except (ServoError, ValueError, TypeError):
        return ()
    # If all features have the same unit, `count` may be any number: the number of features of a
    # scheme of points depends on the target.
    if len(set(units)) == 1:
        return units[:1] * count
    return units if len(units) == count else ()
