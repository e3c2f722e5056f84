"""Postures of the arm for poses of its camera: it hides no target and runs into nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from aras_sim_bridge.errors import SimError
from aras_sim_bridge.rendering.byte_limited_cache import ByteLimitedCache
from aras_visual_servo_controller.errors import UnreachableError
from aras_visual_servo_controller.kinematics import Arm

from ..errors import ExperimentError
from ..experiment.cameras import CameraSetup
from ..experiment.packages import PackagePath
from ..experiment.robots import Robot, parse_robot_description, read_arm
from ..experiment.worlds import read_world
from ..plants.static_arm import StaticArm, without_visuals
from ..targets.target_spec import TargetSpec

# part of a target from which on it counts as hidden: less is of the rim's pixels
MIN_OCCLUSION = 0.01
# What speaks against a posture that runs into something, beside the part of the target that one
# hides: more than to hide all of it.
COLLISION_COST = 2.0


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
    is_visible: bool
    is_solid: bool = False
    world: str = ""

    @classmethod
    def for_robot(
        cls,
        robot: Robot,
        camera: CameraSetup,
        target: TargetSpec,
        is_visible: bool,
        is_solid: bool,
        world: str,
    ) -> Postures:
        """Those of a robot with this control camera."""
        return cls(
            robot.urdf, robot.spec.search, robot.find_optical_frame(camera.name),
            robot.find_target_frame(camera.name),
            target, camera.settings.get("near"), is_visible, is_solid, world,
        )  # fmt: skip

    @property
    def arm(self) -> Arm:
        """The arm."""
        return read_arm(self.urdf, self.frame, self.carrier)

    def compute_occlusion(self, joints: Sequence[float], time: float = 0.0) -> float:
        """Part of the target that the arm at joints (n,) hides from the camera, 0 to 1; 0 where it
        is too little to count, or where the arm cannot be drawn.

        time: s, at which the target is where its motion has it.
        """
        return _compute_occlusion(self, tuple(map(float, joints)), time)

    def find_collision(self, joints: Sequence[float]) -> str:
        """What the arm at joints (n,) runs into, in words; '': nothing, or nothing of it is solid.

        The links of an arm pass through each other, and through what else its description has.
        """
        return _find_collision(self, tuple(map(float, joints))) if self.is_solid else ""

    def compute_cost(self, joints: Sequence[float]) -> float:
        """What speaks against a posture, from 0, nothing, on."""
        touches = COLLISION_COST if self.find_collision(joints) else 0.0
        return touches + (self.compute_occlusion(joints) if self.is_visible else 0.0)

    def find_joints(self, pose: np.ndarray) -> np.ndarray:
        """Joints (n,) with the camera at world_T_camera (4, 4), looked for from zero.

        Raises:
            UnreachableError: the arm cannot be there.
        """
        found = _find_preferred_joints(self, pose.tobytes())
        if isinstance(found, UnreachableError):
            raise UnreachableError(str(found), found.distance)
        return np.array(found)

    def find_start_joints(self, pose: np.ndarray, goal: np.ndarray | None) -> np.ndarray:
        """As `find_joints`, of a start: looked for from the posture at the goal, as the controller
        node does it (goals.starts), so that the arm comes to the goal in that.

        goal: joints (n,) there; None: they are not known.
        """
        return (
            self.find_joints(pose)
            if goal is None
            else self.arm.inverse_kinematics(pose, goal, cost=self.compute_cost)
        )

    def list_faults(self, joints: Sequence[float], where: str, is_given: bool) -> list[str]:
        """What speaks against a posture, in a line each.

        Args:
            joints: (n,). where: 'goal' or 'start'. given: as joints, not as a pose.
        """
        remedy = "give it other joints" if is_given else (
            "and {} in no posture that was found: give another pose"
        )
        found = []
        if touched := self.find_collision(joints):
            found.append(
                f"the arm runs into something at the {where}, {touched}"
                f"{':' if is_given else ','} {remedy.format('clear of all')}"
            )
        part = self.compute_occlusion(joints) if self.is_visible else 0.0
        if part:
            found.append(
                f"the arm hides {100.0 * part:.0f} % of the target at the {where}"
                f"{':' if is_given else ','} {remedy.format('less')}"
            )
        return found


# All runs of a study share a goal.
@lru_cache(maxsize=32)
def _find_preferred_joints(postures: Postures, pose: bytes) -> tuple[float, ...] | UnreachableError:
    arm = postures.arm
    weighs = postures.is_visible or postures.is_solid
    try:
        return tuple(arm.inverse_kinematics(
            np.frombuffer(pose).reshape(4, 4), np.zeros(len(arm.names)),
            cost=postures.compute_cost if weighs else None,
        ))  # fmt: skip
    except UnreachableError as error:
        return error


@lru_cache(maxsize=32)
def _compute_occlusion(postures: Postures, joints: tuple[float, ...], time: float) -> float:
    drawn = _make_static_arm(postures)
    if drawn is None:
        return 0.0
    arm, placed = postures.arm, postures.target.placed_target
    part = drawn.compute_occlusion(
        dict(zip(arm.names, joints, strict=True)), arm.pose(np.array(joints)), placed.shape,
        placed.world_T_target(time), postures.near,
    )  # fmt: skip
    return part if part >= MIN_OCCLUSION else 0.0


@lru_cache(maxsize=32)
def _find_collision(postures: Postures, joints: tuple[float, ...]) -> str:
    posed = _make_static_arm(postures)
    if posed is None:
        return ""
    return posed.find_collision(dict(zip(postures.arm.names, joints, strict=True)))


def _make_static_arm(postures: Postures) -> StaticArm | None:
    """None: it cannot be put into a world; the plant says why."""
    spec, solid = postures.target, postures.is_solid
    own = postures.carrier or spec.is_provided
    bare = spec.link if spec.link and not spec.model else ""  # the target does not hide itself
    target = spec if solid and not own else None
    world = postures.world if solid else ""
    key = postures.urdf, postures.search, postures.carrier, bare, solid, world, target

    def make() -> StaticArm | None:
        try:
            robot = parse_robot_description(postures.urdf, postures.search)
            if bare:
                robot = without_visuals(robot, bare)
            around = read_world(world, PackagePath(postures.search)) if solid else None
            placed = None if target is None else target.placed_target
            return StaticArm(robot, postures.carrier, around, placed)
        except (SimError, ExperimentError):
            return None

    return _static_arms.get(key, make)


# Worlds are large: a robot's meshes are in each of them.
_static_arms: ByteLimitedCache[tuple, StaticArm | None] = ByteLimitedCache(
    2, size=lambda arm: 1, drop=lambda arm: None if arm is None else arm.close()
)
