"""A run of the runner, as a report takes it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aras_visual_servo_controller.arm import Arm
from aras_visual_servo_controller.schemes import JointController, Scheme

from ..asked.experiment import Experiment
from ..numbers.metrics import Finished
from ..study.versions import code, versions
from .record import Images, Record
from .run import Details


def record_of(
    name: str,
    finished: Finished,
    details: Details | None = None,
    pictures: Sequence[np.ndarray] = (),
    source: str = "",
) -> Record:
    """The record of a finished run.

    Args:
        name: of the run. source: where it is from, in words.
        details: of the Loop; None: only what the arrays tell.
        pictures: rgb (rows, columns, 3) of every answered image, or none.
    """
    run, parts, experiment = finished.run, finished.parts, finished.experiment
    scheme: Scheme | JointController = parts.servo.scheme
    arm = parts.servo.arm
    speed = parts.settings.limits(arm).velocity if isinstance(arm, Arm) else np.zeros(0)
    shown = tuple(zip(run.stamp.tolist(), pictures, strict=False))
    return Record(
        name=name,
        source=source,
        run=run,
        details=Details.unknown(run) if details is None else details,
        units=tuple(scheme.units or ()),
        tolerances=tuple(float(t) for t in scheme.tolerances),
        limits=finished.limits,
        speed=speed,
        joint_units=joint_units(arm) if isinstance(arm, Arm) else (),
        camera=finished.camera,
        target=finished.target,
        goal=parts.goal,
        images=Images(run.stamp, run.stamp, shown),
        centres=_centres(finished),
        settings=settings_of(experiment),
        versions={**versions(), "code": code()},
    )


def settings_of(experiment: Experiment) -> dict[str, str]:
    """What of an experiment a reader wants to see first, in words."""
    asked = {key: getattr(experiment, key) for key in (
        "plant", "scheme", "law", "gain", "start", "goal", "camera", "delay", "seed",
    )}  # fmt: skip
    asked["target"] = experiment.target.shape
    return {key: str(value) for key, value in asked.items() if value is not None}


def joint_units(arm: Arm) -> tuple[str, ...]:
    """'m' for joints that slide, 'rad' for others."""
    return tuple("m" if slides else "rad" for slides in arm.prismatic)


def _centres(finished: Finished) -> np.ndarray:
    """(n, 2): of the features, where they are the centre of gravity; else NaN."""
    names = finished.run.names
    if "xg" in names and "yg" in names:
        return finished.run.features[:, [names.index("xg"), names.index("yg")]]
    return np.full((len(finished.run.stamp), 2), np.nan)
