"""Find postures of the arm for a camera pose, without collisions or occlusion of the target."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from aras_sim_bridge.errors import SimError
from aras_visual_servo_base.memory import ByteLimitedCache
from aras_visual_servo_controller.errors import UnreachableError
from aras_visual_servo_controller.kinematics import Arm

from ..errors import ExperimentError
from ..experiment.cameras import CameraSetup
from ..experiment.packages import PackagePath
from ..experiment.robots import Robot, parse_robot_description, read_arm
from ..experiment.worlds import read_world
from ..plants.static_arm import StaticArm, without_visuals
from ..targets.target_spec import TargetSpec

# Hidden fraction of the target from which an occlusion is reported. Smaller fractions result from
# pixels at the target's border.
MIN_OCCLUSION = 0.01
# Cost of a posture in collision. The cost of an occlusion, the hidden fraction of the target, is at
# most 1.
COLLISION_COST = 2.0


@dataclass(frozen=True)
class PostureSearch:
    """Search for postures of an arm that put its control camera at a given pose.

    urdf: text of the robot description.
    search: folders with the packages that the description uses.
    frame: optical frame of the control camera.
    carrier: link that carries the target; '': the target is in the world, at its pose at 0 s.
    target: settings of the target.
    near: near clipping distance of the camera, m; None: the distance in the description.
    is_visible: whether images show the arm; postures that hide less of the target are then
        preferred.
    is_solid: whether the arm can collide with its surroundings; postures in collision are then
        avoided.
    world: path of the world file; '': the world is Gazebo's ground plane.
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
    ) -> PostureSearch:
        """Make the search for postures of a robot with its control camera."""
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
        """Compute the fraction of the target, 0 to 1, that the arm hides from the camera.

        Return 0 if the fraction is below MIN_OCCLUSION, and if the arm cannot be rendered.

        Args:
            joints: joint positions (n,) of the posture.
            time: time at which the pose of a moving target is computed, s.
        """
        return _compute_occlusion(self, tuple(map(float, joints)), time)

    def find_collision(self, joints: Sequence[float]) -> str:
        """Describe a collision of the arm at the positions `joints` (n,); '' if there is none.

        Collisions between two links of the robot description are ignored.
        """
        return _find_collision(self, tuple(map(float, joints))) if self.is_solid else ""

    def compute_cost(self, joints: Sequence[float]) -> float:
        """Compute the cost of a posture: the occlusion, plus COLLISION_COST for a collision."""
        collision = COLLISION_COST if self.find_collision(joints) else 0.0
        return collision + (self.compute_occlusion(joints) if self.is_visible else 0.0)

    def find_joints(self, pose: np.ndarray) -> np.ndarray:
        """Find joint positions (n,) that put the camera at `pose`, world_T_camera (4, 4).

        The search starts with all joints at 0.

        Raises:
            UnreachableError: the arm cannot reach the pose.
        """
        found = _find_preferred_joints(self, pose.tobytes())
        if isinstance(found, UnreachableError):
            raise UnreachableError(str(found), found.distance)
        return np.array(found)

    def find_start_joints(self, pose: np.ndarray, goal: np.ndarray | None) -> np.ndarray:
        """Find start joint positions (n,) that put the camera at `pose`, world_T_camera (4, 4).

        The search starts at the joint positions at the goal, so that the arm can reach the goal
        without changing its configuration.

        goal: joint positions (n,) at the goal; None: not known, so the search starts with all
            joints at 0.

        Raises:
            UnreachableError: the arm cannot reach the pose.
        """
        return (
            self.find_joints(pose)
            if goal is None
            else self.arm.inverse_kinematics(pose, goal, cost=self.compute_cost)
        )

    def list_faults(self, joints: Sequence[float], where: str, is_given: bool) -> list[str]:
        """Return warnings about a collision and an occlusion of a posture, one line each.

        Args:
            joints: joint positions (n,) of the posture.
            where: 'goal' or 'start'.
            is_given: whether the experiment gives these joints; False: it gives a camera pose.
        """
        remedy = "; give other joints" if is_given else (
            ", and no posture {} was found; give another pose"
        )
        found = []
        if collision := self.find_collision(joints):
            found.append(
                f"the arm is in collision at the {where} ({collision})"
                f"{remedy.format('without a collision')}"
            )
        part = self.compute_occlusion(joints) if self.is_visible else 0.0
        if part:
            found.append(
                f"the arm hides {100.0 * part:.0f} % of the target at the {where}"
                f"{remedy.format('that hides less')}"
            )
        return found


# The result is cached, because all runs of a study have the same goal.
@lru_cache(maxsize=32)
def _find_preferred_joints(
    postures: PostureSearch, pose: bytes
) -> tuple[float, ...] | UnreachableError:
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
def _compute_occlusion(postures: PostureSearch, joints: tuple[float, ...], time: float) -> float:
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
def _find_collision(postures: PostureSearch, joints: tuple[float, ...]) -> str:
    static_arm = _make_static_arm(postures)
    if static_arm is None:
        return ""
    return static_arm.find_collision(dict(zip(postures.arm.names, joints, strict=True)))


def _make_static_arm(postures: PostureSearch) -> StaticArm | None:
    """Return the arm in its surroundings; the result is cached.

    Return None if the arm cannot be simulated. No error is raised here, because making the plant
    raises it later.
    """
    spec, solid = postures.target, postures.is_solid
    has_target = postures.carrier or spec.is_provided
    # The arm is rendered without the link that is the target, because the target does not hide
    # itself.
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


# Each cached arm contains all meshes of a robot, so at most two arms are cached.
_static_arms: ByteLimitedCache[tuple, StaticArm | None] = ByteLimitedCache(
    2, size=lambda arm: 1, drop=lambda arm: None if arm is None else arm.close()
)
