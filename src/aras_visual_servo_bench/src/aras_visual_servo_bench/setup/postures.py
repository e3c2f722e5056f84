"""Postures of the arm at given camera poses without occlusion of the target and collisions."""

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

# Least part of a target that counts as hidden; smaller parts result from pixels at its border.
MIN_OCCLUSION = 0.01
# Cost of a posture in collision. Occlusion costs the hidden part of the target, so a collision is
# worse than hiding all of it.
COLLISION_COST = 2.0


@dataclass(frozen=True)
class Postures:
    """Search for postures of an arm that move its control camera to given poses.

    urdf: text of the description. search: folders of its packages. frame: optical frame.
    carrier: link that carries the target; '': the target is in the world, at its pose at 0 s.
    near: near clipping distance of the camera, m; None: the one in the description.
    is_visible: images show the arm; postures in which it hides little of the target are preferred.
    is_solid: the arm can collide with its surroundings; postures in collision are avoided.
    world: path of the world file; '': Gazebo's ground plane.
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
        """Make the search for a robot with this control camera."""
        return cls(
            robot.urdf, robot.spec.search, robot.find_optical_frame(camera.name),
            robot.find_target_frame(camera.name),
            target, camera.settings.get("near"), is_visible, is_solid, world,
        )  # fmt: skip

    @property
    def arm(self) -> Arm:
        """Kinematics of the arm."""
        return read_arm(self.urdf, self.frame, self.carrier)

    def compute_occlusion(self, joints: Sequence[float], time: float = 0.0) -> float:
        """Compute the part of the target, 0 to 1, that the arm hides from the camera.

        The result is 0 below MIN_OCCLUSION, and if the arm cannot be rendered.

        Args:
            joints: (n,).
            time: s, for the pose of a moving target.
        """
        return _compute_occlusion(self, tuple(map(float, joints)), time)

    def find_collision(self, joints: Sequence[float]) -> str:
        """Describe a collision of the arm at joints (n,); '' if there is none.

        Collisions between parts of the robot description are ignored.
        """
        return _find_collision(self, tuple(map(float, joints))) if self.is_solid else ""

    def compute_cost(self, joints: Sequence[float]) -> float:
        """Compute the cost of a posture: its occlusion, plus COLLISION_COST for a collision."""
        collision = COLLISION_COST if self.find_collision(joints) else 0.0
        return collision + (self.compute_occlusion(joints) if self.is_visible else 0.0)

    def find_joints(self, pose: np.ndarray) -> np.ndarray:
        """Find joints (n,) with the camera at world_T_camera (4, 4), starting at zero.

        Raises:
            UnreachableError: the arm cannot reach the pose.
        """
        found = _find_preferred_joints(self, pose.tobytes())
        if isinstance(found, UnreachableError):
            raise UnreachableError(str(found), found.distance)
        return np.array(found)

    def find_start_joints(self, pose: np.ndarray, goal: np.ndarray | None) -> np.ndarray:
        """Find joints (n,) of a start with the camera at world_T_camera (4, 4).

        The search starts at the posture of the goal, as in the controller node (goals.starts), so
        that the arm can reach the goal without changing its configuration.

        goal: joints (n,) at the goal; None: not known, so the search starts at zero.

        Raises:
            UnreachableError: the arm cannot reach the pose.
        """
        return (
            self.find_joints(pose)
            if goal is None
            else self.arm.inverse_kinematics(pose, goal, cost=self.compute_cost)
        )

    def list_faults(self, joints: Sequence[float], where: str, is_given: bool) -> list[str]:
        """Describe collision and occlusion of a posture, one line each.

        Args:
            joints: (n,).
            where: 'goal' or 'start'.
            is_given: whether the experiment gives these joints, rather than a camera pose.
        """
        remedy = ": give other joints" if is_given else (
            ", and no posture {} was found: give another pose"
        )
        found = []
        if collision := self.find_collision(joints):
            found.append(
                f"the arm is in collision at the {where}, {collision}"
                f"{remedy.format('without a collision')}"
            )
        part = self.compute_occlusion(joints) if self.is_visible else 0.0
        if part:
            found.append(
                f"the arm hides {100.0 * part:.0f} % of the target at the {where}"
                f"{remedy.format('that hides less')}"
            )
        return found


# Cached because all runs of a study share a goal.
@lru_cache(maxsize=32)
def _find_preferred_joints(postures: Postures, pose: bytes) -> tuple[float, ...] | UnreachableError:
    arm = postures.arm
    has_cost = postures.is_visible or postures.is_solid
    try:
        return tuple(arm.inverse_kinematics(
            np.frombuffer(pose).reshape(4, 4), np.zeros(len(arm.names)),
            cost=postures.compute_cost if has_cost else None,
        ))  # fmt: skip
    except UnreachableError as error:
        return error


@lru_cache(maxsize=32)
def _compute_occlusion(postures: Postures, joints: tuple[float, ...], time: float) -> float:
    static_arm = _make_static_arm(postures)
    if static_arm is None:
        return 0.0
    arm, target = postures.arm, postures.target.placed_target
    part = static_arm.compute_occlusion(
        dict(zip(arm.names, joints, strict=True)), arm.pose(np.array(joints)), target.shape,
        target.world_T_target(time), postures.near,
    )  # fmt: skip
    return part if part >= MIN_OCCLUSION else 0.0


@lru_cache(maxsize=32)
def _find_collision(postures: Postures, joints: tuple[float, ...]) -> str:
    static_arm = _make_static_arm(postures)
    if static_arm is None:
        return ""
    return static_arm.find_collision(dict(zip(postures.arm.names, joints, strict=True)))


def _make_static_arm(postures: Postures) -> StaticArm | None:
    """Return the arm in its surroundings, cached; None if it cannot be put into a world.

    The plant later raises the error in that case.
    """
    spec, solid = postures.target, postures.is_solid
    has_target = postures.carrier or spec.is_provided
    # A target that is a link of the robot does not hide itself.
    target_link = spec.link if spec.link and not spec.model else ""
    target = spec if solid and not has_target else None
    world = postures.world if solid else ""
    key = postures.urdf, postures.search, postures.carrier, target_link, solid, world, target

    def make() -> StaticArm | None:
        try:
            robot = parse_robot_description(postures.urdf, postures.search)
            if target_link:
                robot = without_visuals(robot, target_link)
            surroundings = read_world(world, PackagePath(postures.search)) if solid else None
            placed = None if target is None else target.placed_target
            return StaticArm(robot, postures.carrier, surroundings, placed)
        except (SimError, ExperimentError):
            return None

    return _static_arms.get(key, make)


# At most two, because each world holds all meshes of a robot.
_static_arms: ByteLimitedCache[tuple, StaticArm | None] = ByteLimitedCache(
    2, size=lambda arm: 1, drop=lambda arm: None if arm is None else arm.close()
)
