"""Units of what a controller tells of, by the name of its scheme."""

from __future__ import annotations

from functools import lru_cache

from aras_visual_servo_controller.errors import ServoError
from aras_visual_servo_controller.settings import Settings


@lru_cache(maxsize=64)
def find_feature_units(scheme: str, count: int) -> tuple[str, ...]:
    """Unit of each of `count` features of a shipped scheme, '' for what has none.

    Empty where they are not known: of a user's own class, which nobody loads for being named in a
    message, and of a scheme that has other features here.
    """
    if ":" in scheme or not scheme:
        return ()
    try:
        units = tuple(Settings(scheme=scheme).make_scheme().units or ())
    except (ServoError, ValueError, TypeError):
        return ()
    if len(set(units)) == 1:  # of points, however many there are
        return units[:1] * count
    return units if len(units) == count else ()
