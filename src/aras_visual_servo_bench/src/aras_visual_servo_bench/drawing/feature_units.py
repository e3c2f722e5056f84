"""Units of the features that a controller reports, from the name of its scheme."""

from __future__ import annotations

from functools import lru_cache

from aras_visual_servo_controller.errors import ServoError
from aras_visual_servo_controller.settings import Settings


@lru_cache(maxsize=64)
def find_feature_units(scheme: str, count: int) -> tuple[str, ...]:
    """Return the units of the `count` features of a shipped scheme; '' for a feature without unit.

    The result is empty if the units are unknown. This is the case for a user's own class, which is
    not imported for its units, and for a scheme with another number of features.
    """
    if ":" in scheme or not scheme:
        return ()
    try:
        units = tuple(Settings(scheme=scheme).make_scheme().units or ())
    except (ServoError, ValueError, TypeError):
        return ()
    if len(set(units)) == 1:  # schemes of points have any number of features
        return units[:1] * count
    return units if len(units) == count else ()
