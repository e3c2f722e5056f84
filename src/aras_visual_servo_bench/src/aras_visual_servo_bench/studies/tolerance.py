"""Tolerance of the pose within which the camera of a run counts as at its goal."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from aras_visual_servo_controller.diagnosis.pose_uncertainty import NEGLIGIBLE_UNCERTAINTY

from ..metrics.formatting import choose_unit, format_in_unit, format_number, format_quantity
from .study import Study

# key of an experiment that sets the tolerance of the final pose: distance and angle
KEY = "reached"
# Largest number of tolerances that a text lists; if there are more, it gives only their range.
MAX_LISTED = 3
# Number of significant digits to which tolerances are rounded before duplicates are removed.
DIGITS = 6


@dataclass(frozen=True)
class SuccessTolerance:
    """Maximum distance and angle from its goal at which a camera counts as at its goal.

    pairs: distance (m) and angle (rad) that the runs of a study use, without duplicates; empty if
        they are unknown.
    is_relative: True if the distance is set as a fraction of the target's depth at the goal.
    """

    pairs: tuple[tuple[float, float], ...]
    is_relative: bool

    @property
    def text(self) -> str:
        """The tolerance as text, such as '0.3 mm and 0.3°'."""
        fraction = f"{format_number(100.0 * NEGLIGIBLE_UNCERTAINTY[0])} % of the target's depth"
        if not self.pairs:
            return f"{fraction} and {_format_angle(NEGLIGIBLE_UNCERTAINTY[1])}"
        share = f" ({fraction})" if self.is_relative else ""
        if len(self.pairs) <= MAX_LISTED:
            return " or ".join(
                f"{format_in_unit(distance, 'm')}{share} and {_format_angle(angle)}"
                for distance, angle in self.pairs
            )
        distances, angles = zip(*self.pairs, strict=True)
        unit, size = choose_unit("m", distances)
        ends = [format_number(end / size) for end in (min(distances), max(distances))]
        spread = format_quantity(" to ".join(dict.fromkeys(ends)), unit)
        angle_ends = dict.fromkeys(map(_format_angle, (min(angles), max(angles))))
        return f"{spread}{share} and {' to '.join(angle_ends)}"


def find_tolerance(study: Study, distances: np.ndarray, angles: np.ndarray) -> SuccessTolerance:
    """Return the tolerance of the camera pose that the runs of a study use.

    Args:
        study: settings of the study.
        distances: (n,) tolerance of the distance that each run used, m; NaN for a run that was
            refused or raised an error.
        angles: (n,) tolerance of the angle that each run used, rad.
    """
    configured = _list_configured(study)
    known = np.isfinite(distances)
    pairs = dict.fromkeys(
        (_round(distance), _round(angle))
        for distance, angle in zip(distances[known], angles[known], strict=True)
    ) or dict.fromkeys(pair for pair in configured if pair is not None)
    return SuccessTolerance(tuple(pairs), bool(configured) and not any(configured))


def _list_configured(study: Study) -> list[tuple[float, float] | None]:
    """Return the values that a study gives to the key `reached`; None for the default value."""
    found = [case.set[KEY] for case in study.combinations if KEY in case.set]
    is_varied = any(one.key == KEY for one in (*study.axes, *study.random_variations))
    if len(found) < len(study.combinations) and not is_varied:
        found.insert(0, study.experiment.get(KEY))
    found += [value for axis in study.axes if axis.key == KEY for value in axis.values]
    return [None if value is None else (float(value[0]), float(value[1])) for value in found]


def _round(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def _format_angle(angle: float) -> str:
    return f"{format_number(math.degrees(angle))}°"
