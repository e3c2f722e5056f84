"""Where a protocol's runs begin: poses of the camera about the goal's, drawn by the seed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from aras_visual_servo_base.names import nearest
from aras_visual_servo_base.poses import exponential, relative, to_xyz_rpy, transform
from aras_visual_servo_base.settings import check, parameter

from ..errors import ExperimentError, require
from .experiment import CameraPose, Experiment

Three = tuple[float, float, float]


@dataclass(frozen=True)
class Placing:
    """How a start is found from the goal's pose; angles in degrees, lengths in m.

    kind: one of START_KINDS. name: for the table; empty: the kind.
    angle: by which the camera is turned (turned, tilted), or the plane of the target is (plane).
    axis: in the camera's frame, of `turned`. distance: by which it is drawn back (back).
    box, radii, turn, middle: of `looking`: greatest offset, circles of the points looked at, turn
        about the optical axis, which is spaced evenly over `of` seeds.
    scatter: greatest additional offset (m) and turn about each axis, drawn by the seed.
    published: of runs from here; see Case.
    """

    kind: str
    name: str = ""
    angle: float = 0.0
    axis: Three = (0.0, 0.0, 1.0)
    distance: float = 0.0
    box: Three = (0.6, 0.6, 0.15)
    radii: tuple[float, ...] = (0.08, 0.16, 0.24, 0.32)
    turn: float = 120.0
    of: int = parameter(100, least=1)
    scatter: tuple[float, float] = parameter((0.0, 0.0), least=0.0)
    published: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check(self, ExperimentError, "starts")
        require(self.kind in START_KINDS, f"starts: {nearest(self.kind, START_KINDS)}")


def placed(experiment: Experiment, placing: Placing, seed: int) -> Experiment:
    """The experiment with its start.

    Raises:
        ExperimentError: its goal is no pose, to which the start could be relative.
    """
    if placing.kind == "given":
        return experiment
    if not isinstance(experiment.goal, CameraPose):
        raise ExperimentError(
            f"starts of kind '{placing.kind}' are relative to the goal: give it as a pose"
        )
    goal = transform(experiment.goal.pose[:3], experiment.goal.pose[3:])
    target = transform(experiment.target.pose[:3], experiment.target.pose[3:])
    random = np.random.default_rng((seed, 7919))
    pose = START_KINDS[placing.kind](placing, goal, target, seed, random)
    offset, turn = placing.scatter
    if offset or turn:
        shift = random.uniform(-offset, offset, 3)
        angles = np.radians(random.uniform(-turn, turn, 3))
        pose = pose @ exponential((*shift, *angles))
    xyz, rpy = to_xyz_rpy(pose)
    return replace(experiment, start=CameraPose((*xyz, *rpy)))


def _turned(
    placing: Placing, goal: np.ndarray, target: np.ndarray, seed: int, random: np.random.Generator
) -> np.ndarray:
    """The camera turned about an axis of its own, on its spot."""
    axis = np.asarray(placing.axis) / np.linalg.norm(placing.axis)
    return goal @ exponential((0.0, 0.0, 0.0, *(np.radians(placing.angle) * axis)))


def _back(
    placing: Placing, goal: np.ndarray, target: np.ndarray, seed: int, random: np.random.Generator
) -> np.ndarray:
    """The camera drawn back along its optical axis."""
    return goal @ exponential((0.0, 0.0, -placing.distance, 0.0, 0.0, 0.0))


def _plane(
    placing: Placing, goal: np.ndarray, target: np.ndarray, seed: int, random: np.random.Generator
) -> np.ndarray:
    """The camera gone round the target: to it, the target's plane is turned about its x axis."""
    centred = relative(target, goal)
    angle = np.radians(placing.angle)
    return target @ exponential((0.0, 0.0, 0.0, angle, 0.0, 0.0)) @ centred


def _looking(
    placing: Placing, goal: np.ndarray, target: np.ndarray, seed: int, random: np.random.Generator
) -> np.ndarray:
    """In a box about the goal, looking at a point of a circle on the target, turned.

    The protocol of Felton and others: the point lies on one of the circles, the turn about the
    optical axis runs linearly over the seeds.
    """
    offset = random.uniform(-1.0, 1.0, 3) * placing.box
    radius = random.choice(placing.radii)
    around = random.uniform(-np.pi, np.pi)
    point = target[:3, 3] + target[:3, :3] @ (radius * np.cos(around), radius * np.sin(around), 0.0)
    place = goal[:3, 3] + goal[:3, :3] @ offset
    forward = (point - place) / np.linalg.norm(point - place)
    right = goal[:3, 0] - (goal[:3, 0] @ forward) * forward
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = place
    part = (seed % placing.of) / max(placing.of - 1, 1)
    turn = np.radians(placing.turn * (2.0 * part - 1.0))
    return pose @ exponential((0.0, 0.0, 0.0, 0.0, 0.0, turn))


def _given(
    placing: Placing, goal: np.ndarray, target: np.ndarray, seed: int, random: np.random.Generator
) -> np.ndarray:
    """The experiment's own start stands."""
    return goal


Kind = Callable[[Placing, np.ndarray, np.ndarray, int, np.random.Generator], np.ndarray]
START_KINDS: dict[str, Kind] = {
    "given": _given, "turned": _turned, "back": _back, "plane": _plane, "looking": _looking,
}  # fmt: skip
