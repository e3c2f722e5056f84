"""Postures of the arm at poses of its camera, such that the arm does not hide the target."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from aras_sim_bridge.errors import SimError
from aras_visual_servo_controller.arm import Arm
from aras_visual_servo_controller.errors import UnreachableError

from ..errors import ExperimentError
from ..plants.drawn_arm import DrawnArm
from .cameras import Eye
from .robots import Robot, arm_from, described
from .target_spec import TargetSpec

log = logging.getLogger(__name__)
HIDDEN = 0.01  # part of a target from which on it counts as hidden: less is of the rim's pixels


@dataclass(frozen=True)
class Postures:
    """Of an arm with its control camera before a target; equal for all runs of a study.

    urdf: text of the description. search: folders that hold its packages. frame: of the camera.
    carrier: link that carries the target; '': it stands in the world, where it is at 0 s.
    near: m before the camera within which nothing is drawn; None: as the description has it.
    drawn: pictures show the arm, and postures in which it hides little are preferred.
    """

    urdf: str
    search: tuple[str, ...]
    frame: str
    carrier: str
    target: TargetSpec
    near: float | None
    drawn: bool

    @classmethod
    def of(cls, robot: Robot, eye: Eye, target: TargetSpec, drawn: bool) -> Postures:
        """Those of a robot with this control camera."""
        return cls(
            robot.urdf, robot.spec.search, robot.frame(eye.name), robot.target_frame(eye.name),
            target,
            eye.settings.get("near"), drawn,
        )  # fmt: skip

    @property
    def arm(self) -> Arm:
        """The arm."""
        return arm_from(self.urdf, self.frame, self.carrier)

    def hidden(self, joints: Sequence[float], time: float = 0.0) -> float:
        """Part of the target that the arm at joints (n,) hides from the camera, 0 to 1; 0 where it
        is too little to count, or where the arm cannot be drawn.

        time: s, at which the target is where its motion has it.
        """
        return _hidden(self, tuple(map(float, joints)), time)

    def at(self, pose: np.ndarray) -> np.ndarray:
        """Joints (n,) with the camera at world_T_camera (4, 4), looked for from zero.

        Raises:
            UnreachableError: the arm cannot be there.
        """
        found = _preferred(self, pose.tobytes())
        if isinstance(found, UnreachableError):
            raise UnreachableError(str(found), found.excess)
        return np.array(found)

    def start(self, pose: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """As `at`, of a start: where the goal's posture was not the first found, it is looked for
        from that, so that the arm comes to the goal in it.

        goal: world_T_camera (4, 4) there.
        """
        first = _first(self.urdf, self.frame, self.carrier, goal.tobytes())
        if not self.drawn or isinstance(first, UnreachableError):
            return self.at(pose)
        there = self.at(goal)
        if np.array_equal(there, first):
            return self.at(pose)
        return self.arm.inverse(pose, there, cost=self.hidden)


@lru_cache
def warn(note: str) -> None:
    """Into the log, once a process: the runs of a study have much in common."""
    log.warning("%s", note)


# All runs of a study share a goal.
@lru_cache(maxsize=32)
def _first(
    urdf: str, frame: str, carrier: str, pose: bytes
) -> tuple[float, ...] | UnreachableError:
    arm = arm_from(urdf, frame, carrier)
    try:
        return tuple(arm.inverse(np.frombuffer(pose).reshape(4, 4), np.zeros(len(arm.names))))
    except UnreachableError as error:
        return error


@lru_cache(maxsize=32)
def _preferred(postures: Postures, pose: bytes) -> tuple[float, ...] | UnreachableError:
    first = _first(postures.urdf, postures.frame, postures.carrier, pose)
    unreachable = isinstance(first, UnreachableError)
    if unreachable or not postures.drawn or not postures.hidden(first):
        return first
    arm, wanted = postures.arm, np.frombuffer(pose).reshape(4, 4)
    return tuple(arm.inverse(wanted, np.zeros(len(arm.names)), cost=postures.hidden))


@lru_cache(maxsize=32)
def _hidden(postures: Postures, joints: tuple[float, ...], time: float) -> float:
    drawn = _drawn(postures.urdf, postures.search, postures.carrier)
    if drawn is None:
        return 0.0
    arm, placed = postures.arm, postures.target.placed
    part = drawn.hidden(
        dict(zip(arm.names, joints, strict=True)), arm.pose(np.array(joints)), placed.shape,
        placed.world_T_target(time), postures.near,
    )  # fmt: skip
    return part if part >= HIDDEN else 0.0


@lru_cache(maxsize=4)
def _drawn(urdf: str, search: tuple[str, ...], carrier: str) -> DrawnArm | None:
    try:
        return DrawnArm(described(urdf, search), carrier)
    except (SimError, ExperimentError):
        return None
