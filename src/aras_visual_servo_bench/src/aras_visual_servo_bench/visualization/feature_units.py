"""Units and tolerances of the features of a scheme, found by the name of the scheme."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

from aras_visual_servo_controller.errors import ServoError
from aras_visual_servo_controller.features.base import DepthRelativeTolerance
from aras_visual_servo_controller.settings import ControllerSettings


def find_feature_units(scheme: str, count: int) -> tuple[str, ...]:
    """Return the unit of each feature of a scheme; '' for a feature without unit.

    The result is empty if the units are unknown. This is so for schemes that are not part of the
    project, and for a scheme of the project whose number of features is not `count`.
    """
    return _read_attribute(scheme, count, "units")


def find_feature_tolerances(
    scheme: str, count: int, depth: float | None
) -> tuple[float | None, ...]:
    """Return the tolerance of each feature of a scheme, below which its error has converged.

    The result is empty if the tolerances are unknown. A tolerance that is proportional to the depth
    of the target is None if `depth` is None.

    depth: depth of the target at the goal, m; None if it is unknown.
    """
    return tuple(
        (None if depth is None else float(t) * depth)
        if isinstance(t, DepthRelativeTolerance)
        else float(t)
        for t in _read_attribute(scheme, count, "tolerances")
    )


@lru_cache(maxsize=64)
def _read_attribute(scheme: str, count: int, attribute: str) -> tuple[Any, ...]:
    """Return `attribute` of each of a scheme's `count` features; return () if it is unknown."""
    if ":" in scheme or not scheme:
        return ()
    try:
        values: Sequence[Any] = tuple(
            getattr(ControllerSettings(scheme=scheme).make_scheme(), attribute) or ()
        )
    except (ServoError, ValueError, TypeError):
        return ()
    # If all features have the same value, this value is repeated `count` times, because the number
    # of features of such a scheme can depend on the target.
    if len(set(values)) == 1:
        return tuple(values[:1]) * count
    return tuple(values) if len(values) == count else ()
