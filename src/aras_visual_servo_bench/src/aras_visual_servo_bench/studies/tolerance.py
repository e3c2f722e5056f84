"""Tolerance within which the runs of a study count as being at their goal."""

from __future__ import annotations

import math
from dataclasses import dataclass

from aras_visual_servo_controller.diagnosis.pose_uncertainty import NEGLIGIBLE_UNCERTAINTY

from ..errors import BenchError
from ..metrics.formatting import format_in_unit, format_number
from ..setup.assembly import assemble
from .study import Study

KEY = "reached"  # key of an experiment that sets the tolerance: distance and angle
# Keys of an experiment that can change the depth of the target at the goal.
DEPTH_KEYS = ("goal", "target", "robot", "camera_xyz", "camera_rpy", "hand_eye", "cameras", "world")


@dataclass(frozen=True)
class Tolerance:
    """Largest distance and angle of a camera that counts as being at its goal.

    distance: largest distance, m; None: 0.15 % of the depth of the target at the goal.
    angle: largest angle, rad.
    depth: depth of the target at the goal, m; NaN if it is not needed or differs between runs.
    """

    distance: float | None
    angle: float
    depth: float = math.nan

    @property
    def limit(self) -> float:
        """Largest distance, m; NaN if it is a fraction of an unknown depth."""
        if self.distance is not None:
            return self.distance
        return NEGLIGIBLE_UNCERTAINTY[0] * self.depth

    @property
    def text(self) -> str:
        """The tolerance as text, such as '0.3 mm and 0.3°'."""
        angle = f"{format_number(math.degrees(self.angle))}°"
        known = "" if math.isnan(self.limit) else format_in_unit(self.limit, "m")
        if self.distance is not None:
            return f"{known} and {angle}"
        fraction = f"{format_number(100.0 * NEGLIGIBLE_UNCERTAINTY[0])} % of the target's depth"
        return f"{known} ({fraction}) and {angle}" if known else f"{fraction} and {angle}"


def find_tolerances(study: Study) -> tuple[Tolerance, ...]:
    """Return the different tolerances of the runs of a study, in order of appearance."""
    found = [study.experiment.get(KEY)] if KEY not in study.keys else []
    for combination in study.combinations:
        if KEY in combination.set:
            found.append(combination.set[KEY])
    if found and all(KEY in combination.set for combination in study.combinations):
        del found[0]
    found += [value for axis in study.axes if axis.key == KEY for value in axis.values]
    distinct = dict.fromkeys(None if value is None else tuple(value) for value in found)
    return tuple(
        Tolerance(None, NEGLIGIBLE_UNCERTAINTY[1], find_goal_depth(study)) if value is None
        else Tolerance(*map(float, value)) for value in distinct
    )  # fmt: skip


def find_goal_depth(study: Study) -> float:
    """Return the depth of the target at the goal, m; NaN if it differs between runs."""
    varied = [key for combination in study.combinations for key in combination.set]
    varied += [variation.key for variation in (*study.axes, *study.random_variations)]
    if any(key.partition(".")[0] in DEPTH_KEYS for key in varied):
        return math.nan
    try:
        parts = assemble(study.make_experiment(0))
    except BenchError:  # for example, a file of the study is not on this machine
        return math.nan
    offset = parts.cameras[parts.rig.control.name].spec.calibration_offset
    parts.plant.close()
    return float(parts.goal.distance / offset.depth)
