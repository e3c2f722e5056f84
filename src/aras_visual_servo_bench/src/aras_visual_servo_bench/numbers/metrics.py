"""What is told of a run by one number, each a small function with its unit and source.

A user's own is named 'package.module:function' and decorated the same way:

    @metric(unit="m", better="smaller", source="this paper, equation 3")
    def closest(finished: Finished) -> float: ...
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from aras_visual_servo_base.names import nearest
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.arm.poses import pose_difference

from ..asked.assembly import Assembly
from ..asked.experiment import Experiment
from ..errors import StudyError, ViewError
from ..recording.run import Run
from ..targets.geometry import PlacedTarget

SMALLER, GREATER = "smaller", "greater"
AT_LIMIT = 1e-3  # part of a joint's range
SETTLED, DECAY_FROM, DECAY_TO = 0.02, 0.80, 0.15  # parts of the first error


@dataclass(frozen=True)
class Finished:
    """A run that is over: what was asked, what it was made of, what it left."""

    experiment: Experiment
    parts: Assembly
    run: Run

    @functools.cached_property
    def servoing(self) -> np.ndarray:
        """(m,) bool, joint states since the first image."""
        return self.run.servoing

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest joints (j,), rad or m; empty where there are none."""
        arm = self.parts.servo.arm
        return tuple(np.asarray(getattr(arm, side, ()), float) for side in ("lower", "upper"))

    @property
    def target(self) -> PlacedTarget:
        """In the world."""
        return self.parts.target

    @property
    def camera(self) -> CameraModel:
        """The true one."""
        return self.parts.plant.camera


class Judged(Protocol):
    """What the built-in metrics ask of a run: a Finished has it, and a report's Record.

    Attributes:
        run: the arrays. servoing: (m,) bool, joint states since the first image.
        limits: least and greatest joints (j,). target, camera: the true ones, or None.
    """

    run: Run
    servoing: np.ndarray
    limits: tuple[np.ndarray, np.ndarray]
    target: PlacedTarget | None
    camera: CameraModel | None


@dataclass(frozen=True)
class Metric:
    """A function of a finished run; NaN where the run has no such number.

    name: column in the results. unit: '' for none. better: 'smaller' or 'greater'.
    source: where it is defined. measure: the function.
    """

    name: str
    unit: str
    better: str
    source: str
    measure: Callable[[Finished], float]

    @property
    def text(self) -> str:
        """What it is, in a line."""
        return (self.measure.__doc__ or "").strip().splitlines()[0]


def metric(unit: str, better: str, source: str) -> Callable[[Callable], Metric]:
    """Make a metric of a function that has a docstring."""
    if better not in (SMALLER, GREATER):
        raise StudyError(f"better is '{better}', must be {SMALLER} or {GREATER}")
    return lambda measure: Metric(measure.__name__, unit, better, source, measure)


def find(name: str) -> Metric:
    """The metric of that name, built in or a user's own.

    Raises:
        StudyError: there is none, with the nearest name.
    """
    module, colon, attribute = name.partition(":")
    if not colon:
        if name not in BUILT_IN:
            raise StudyError(f"unknown metric '{name}': {nearest(name, BUILT_IN)}")
        return BUILT_IN[name]
    try:
        found = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise StudyError(f"metric {name}: {error}; is its folder on PYTHONPATH?") from None
    if not isinstance(found, Metric):
        raise StudyError(f"{name} is no metric: decorate it with @metric(unit, better, source)")
    return found


@metric("", GREATER, "the loop's outcome and the physics' verdict together")
def success(finished: Judged) -> float:
    """1 where the loop holds that it has converged and the camera truly stands at its goal."""
    return float(finished.run.converged and finished.run.verdict.reached)


@metric("s", SMALLER, "control's 2 % band, of the camera's true way")
def settled(finished: Judged) -> float:
    """Time until the camera stays within 2 % of its first way."""
    time = finished.run.settled()
    return time if np.isfinite(time) else np.nan


@metric("", SMALLER, "control's overshoot, of the worst feature")
def overshoot(finished: Judged) -> float:
    """How far a feature's error goes beyond its goal, as a part of its first error."""
    error = finished.run.error
    error = error[np.isfinite(error).all(axis=1)]
    if not error.size:
        return np.nan
    size = np.abs(error[0])
    # A feature that begins at its goal has no first error to compare with.
    moving = size > SETTLED * np.max(size, initial=0.0)
    if not moving.any():
        return 0.0
    beyond = -np.sign(error[0, moving]) * error[:, moving] / size[moving]
    return float(max(beyond.max(), 0.0))


@metric("m", SMALLER, "pose of the physics")
def final_distance(finished: Judged) -> float:
    """How far the camera is from its goal at the end."""
    return finished.run.verdict.distance


@metric("rad", SMALLER, "pose of the physics")
def final_angle(finished: Judged) -> float:
    """How far the camera is turned from its goal at the end."""
    return finished.run.verdict.angle


@metric("m", SMALLER, "pose of the physics")
def path_length(finished: Judged) -> float:
    """Length of the camera's way."""
    places = finished.run.true_pose[finished.servoing, :3, 3]
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())


@metric("", SMALLER, "pose of the physics; 1 is a straight line")
def path_ratio(finished: Judged) -> float:
    """Length of the camera's way over the distance from its start to its goal."""
    poses = finished.run.true_pose[finished.servoing]
    if not len(poses):
        return np.nan
    straight = pose_difference(finished.run.goal_pose, poses[0])[0]
    return path_length.measure(finished) / straight if straight > 1e-6 else np.nan


@metric("rad²/s", SMALLER, "integral of the squared joint speeds; m²/s for joints that slide")
def energy(finished: Judged) -> float:
    """What the joints' motion costs: the integral of the sum of their squared speeds."""
    run, after = finished.run, finished.servoing
    if after.sum() < 2:
        return np.nan
    power = np.square(run.true_speed[after]).sum(axis=1)
    return float(np.trapezoid(power, run.joint_stamp[after]))


@metric("s", SMALLER, "joints of the physics, limits of the description")
def limit_time(finished: Judged) -> float:
    """Time during which a joint stands at one of its limits."""
    run, after = finished.run, finished.servoing
    lower, upper = finished.limits
    if after.sum() < 2 or lower.shape != run.true_joints.shape[1:]:
        return 0.0
    margin = AT_LIMIT * np.where(np.isfinite(upper - lower), upper - lower, 0.0)
    q = run.true_joints[after]
    at = ((q <= lower + margin) | (q >= upper - margin)).any(axis=1)
    return float(np.diff(run.joint_stamp[after])[at[:-1]].sum())


@metric("", SMALLER, "exact projection of the target's corners by the true camera")
def image_excursion(finished: Judged) -> float:
    """Farthest place of a corner from the image's centre, in half sizes: above 1 it was outside."""
    target, camera = finished.target, finished.camera
    if target is None or camera is None:
        return np.nan
    half = np.array([camera.width, camera.height]) / 2.0
    worst = np.nan
    for stamp, pose in zip(finished.run.stamp, finished.run.pose, strict=True):
        try:
            seen = target.shape.points(target.seen_from(pose, float(stamp)))
        except ViewError:
            return float("inf")
        pixels = np.column_stack(camera.project(*seen.T)) + 0.5
        worst = np.fmax(worst, np.abs(pixels / half - 1.0).max())
    return float(worst)


@metric("1/s", GREATER, "logarithm of the error between 80 and 15 % of its first value")
def decay_rate(finished: Judged) -> float:
    """How fast the norm of the features' error, each in parts of its first, decays."""
    run = finished.run
    known = np.isfinite(run.error).all(axis=1)
    stamp, error = run.stamp[known], run.error[known]
    if len(stamp) < 4:
        return np.nan
    first = np.abs(error[0])
    error = error[:, first > SETTLED * first.max()]
    if not error.size:
        return np.nan
    part = np.linalg.norm(error / np.abs(error[0]), axis=1)
    part = part / part[0]
    begin, end = int(np.argmax(part < DECAY_FROM)), int(np.argmax(part < DECAY_TO)) or len(part)
    if end - begin < 4:
        return np.nan
    return float(-np.polyfit(stamp[begin:end], np.log(part[begin:end]), 1)[0])


BUILT_IN: dict[str, Metric] = {
    m.name: m
    for m in (
        success, settled, overshoot, final_distance, final_angle, path_length, path_ratio, energy,
        limit_time, image_excursion, decay_rate,
    )
}  # fmt: skip
