"""Postures of the arm for poses of its camera: it hides no target and runs into nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from aras_sim_bridge.errors import SimError
from aras_sim_bridge.rendering.recent import Recent
from aras_visual_servo_controller.arm import Arm
from aras_visual_servo_controller.errors import UnreachableError

from ..asked.cameras import Eye
from ..asked.packages import PackagePath
from ..asked.robots import Robot, arm_from, described
from ..asked.worlds import read_world
from ..errors import ExperimentError
from ..plants.posed_arm import PosedArm, without_visuals
from ..targets.target_spec import TargetSpec

HIDDEN = 0.01  # part of a target from which on it counts as hidden: less is of the rim's pixels
# What speaks against a posture that runs into something, beside the part of the target that one
# hides: more than to hide all of it.
TOUCHES = 2.0


@dataclass(frozen=True)
class Postures:
    """Of an arm with its control camera before a target; equal for all runs of a study.

    urdf: text of the description. search: folders that hold its packages. frame: of the camera.
    carrier: link that carries the target; '': it stands in the world, where it is at 0 s.
    near: m before the camera within which nothing is drawn; None: as the description has it.
    drawn: pictures show the arm, and postures in which it hides little are preferred.
    solid: the arm can run into what is there, and postures in which it does are left out.
    world: path of the world file; '': the arm stands on Gazebo's ground plane.
    """

    urdf: str
    search: tuple[str, ...]
    frame: str
    carrier: str
    target: TargetSpec
    near: float | None
    drawn: bool
    solid: bool = False
    world: str = ""

    @classmethod
    def of(
        cls, robot: Robot, eye: Eye, target: TargetSpec, drawn: bool, solid: bool, world: str
    ) -> Postures:
        """Those of a robot with this control camera."""
        return cls(
            robot.urdf, robot.spec.search, robot.frame(eye.name), robot.target_frame(eye.name),
            target, eye.settings.get("near"), drawn, solid, world,
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

    def touched(self, joints: Sequence[float]) -> str:
        """What the arm at joints (n,) runs into, in words; '': nothing, or nothing of it is solid.

        The links of an arm pass through each other, and through what else its description has.
        """
        return _touched(self, tuple(map(float, joints))) if self.solid else ""

    def against(self, joints: Sequence[float]) -> float:
        """What speaks against a posture, from 0, nothing, on."""
        touches = TOUCHES if self.touched(joints) else 0.0
        return touches + (self.hidden(joints) if self.drawn else 0.0)

    def at(self, pose: np.ndarray) -> np.ndarray:
        """Joints (n,) with the camera at world_T_camera (4, 4), looked for from zero.

        Raises:
            UnreachableError: the arm cannot be there.
        """
        found = _preferred(self, pose.tobytes())
        if isinstance(found, UnreachableError):
            raise UnreachableError(str(found), found.excess)
        return np.array(found)

    def start(self, pose: np.ndarray, goal: np.ndarray | None) -> np.ndarray:
        """As `at`, of a start: looked for from the posture at the goal, as the controller node
        does it (goals.starts), so that the arm comes to the goal in that.

        goal: joints (n,) there; None: they are not known.
        """
        return self.at(pose) if goal is None else self.arm.inverse(pose, goal, cost=self.against)

    def faults(self, joints: Sequence[float], where: str, given: bool) -> list[str]:
        """What speaks against a posture, in a line each.

        Args:
            joints: (n,). where: 'goal' or 'start'. given: as joints, not as a pose.
        """
        remedy = "give it other joints" if given else (
            "and {} in no posture that was found: give another pose"
        )
        found = []
        if touched := self.touched(joints):
            found.append(
                f"the arm runs into something at the {where}, {touched}"
                f"{':' if given else ','} {remedy.format('clear of all')}"
            )
        part = self.hidden(joints) if self.drawn else 0.0
        if part:
            found.append(
                f"the arm hides {100.0 * part:.0f} % of the target at the {where}"
                f"{':' if given else ','} {remedy.format('less')}"
            )
        return found


# All runs of a study share a goal.
@lru_cache(maxsize=32)
def _preferred(postures: Postures, pose: bytes) -> tuple[float, ...] | UnreachableError:
    arm = postures.arm
    weighs = postures.drawn or postures.solid
    try:
        return tuple(arm.inverse(
            np.frombuffer(pose).reshape(4, 4), np.zeros(len(arm.names)),
            cost=postures.against if weighs else None,
        ))  # fmt: skip
    except UnreachableError as error:
        return error


@lru_cache(maxsize=32)
def _hidden(postures: Postures, joints: tuple[float, ...], time: float) -> float:
    drawn = _posed(postures)
    if drawn is None:
        return 0.0
    arm, placed = postures.arm, postures.target.placed
    part = drawn.hidden(
        dict(zip(arm.names, joints, strict=True)), arm.pose(np.array(joints)), placed.shape,
        placed.world_T_target(time), postures.near,
    )  # fmt: skip
    return part if part >= HIDDEN else 0.0


@lru_cache(maxsize=32)
def _touched(postures: Postures, joints: tuple[float, ...]) -> str:
    posed = _posed(postures)
    if posed is None:
        return ""
    return posed.touched(dict(zip(postures.arm.names, joints, strict=True)))


def _posed(postures: Postures) -> PosedArm | None:
    """None: it cannot be put into a world; the plant says why."""
    spec, solid = postures.target, postures.solid
    own = postures.carrier or spec.brought
    bare = spec.link if spec.link and not spec.model else ""  # the target does not hide itself
    target = spec if solid and not own else None
    world = postures.world if solid else ""
    key = postures.urdf, postures.search, postures.carrier, bare, solid, world, target

    def make() -> PosedArm | None:
        try:
            robot = described(postures.urdf, postures.search)
            if bare:
                robot = without_visuals(robot, bare)
            around = read_world(world, PackagePath(postures.search)) if solid else None
            placed = None if target is None else target.placed
            return PosedArm(robot, postures.carrier, around, placed)
        except (SimError, ExperimentError):
            return None

    return _arms.get(key, make)


# Worlds are large: a robot's meshes are in each of them.
_arms: Recent[tuple, PosedArm | None] = Recent(
    2, size=lambda arm: 1, drop=lambda arm: None if arm is None else arm.close()
)
