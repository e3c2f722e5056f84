"""Goal of the servo loop: the view and the pose of the camera, stored in a YAML file.

Moments do not depend on the intrinsic parameters; kernel features are valid for one camera only.
All of them depend on the mounting of the camera. If the stored pose differs from the arm's pose at
the stored joints, the goal was taught with another mounting. It is then rejected or, if the file
contains the target's geometry, computed again.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from aras_visual_servo_base.poses import pose_difference
from aras_visual_servo_base.yaml_files import parse_yaml, read_text
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.interaction import Plane, transform_plane
from aras_visual_servo_camera.moments import MAX_ORDER, Moments

from ..errors import ConfigurationError, ServoError
from ..kinematics.command_limits import check_within_limits
from ..observation.camera_rig import CameraKinematics, InverseCameraKinematics
from ..observation.observation import CAMERA, Observation
from ..observation.target_geometry import TargetGeometry, ellipse_of
from .goal_file import EDGE_ON_COSINE, GoalKernel, read_goal_fields, write_goal_text

if TYPE_CHECKING:
    from ..kinematics import Arm

# Depth of the laboratory's target, m. It is used if the goal contains no depth.
DEFAULT_DEPTH = 0.2
# An arm cannot reach a pose if its inverse kinematics leave an error of more than this, m. A
# rotation error of 1 rad counts as 0.1 m.
REACH_TOLERANCE = 2e-3
# The camera's mounting has changed since teaching if the camera's pose at the goal's joints differs
# from the stored pose by more than this, m and rad.
SAME_PLACE, SAME_ANGLE = 1e-4, 1e-3


class TeachableScheme(Protocol):
    """Interface of schemes and controllers whose features store data in the goal."""

    def teach(self, observation: Observation) -> Mapping[str, Mapping[str, Any]]:
        """Return the data that each feature stores in the goal, by feature name."""


@dataclass(frozen=True, eq=False)
class Goal:
    """View and pose of the camera at its goal; unknown entries are None or empty.

    A feature takes its desired value s* from the goal. A goal is created by `load` from a file, by
    `teach` from an observation, or by an experiment. `a_T_b` (4, 4) maps b to a; the optical frame
    has z forward, x right, y down.

    Attributes:
        name: name of the goal file, for messages.
        joints: posture that brings the camera to the goal pose, by joint name, rad or m.
        world_T_camera: (4, 4) pose of the optical frame in the arm's base.
        depth: Z* of the target's plane along the optical axis, m.
        plane: plane of the target in the optical frame.
        moments: moments of the target in the goal's view.
        kernel: kernel features of the original package, with the camera that measured them.
        camera: intrinsics of the camera with which the goal was taught.
        features: taught data of each feature, by feature name.
        target: geometry of the target in the arm's base.
        mounting: (4, 4) pose of the camera on its link when the goal was taught.
        camera_name: name of the control camera, for a scheme with several cameras.
        other_cameras: goals of the other cameras, by name.
        marker: `DICTIONARY:number` of the marker that is the target.
    """

    name: str = "goal"
    joints: Mapping[str, float] = field(default_factory=dict)
    world_T_camera: np.ndarray | None = None
    depth: float | None = None
    plane: Plane | None = None
    moments: Moments | None = None
    kernel: GoalKernel | None = None
    camera: CameraModel | None = None
    features: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    target: TargetGeometry | None = None
    mounting: np.ndarray | None = None
    camera_name: str = CAMERA
    other_cameras: Mapping[str, Goal] = field(default_factory=dict)
    marker: str = ""

    @cached_property
    def distance(self) -> float:
        """Depth of the target's plane on the optical axis, m: the scene's unit of length."""
        if self.plane is not None and self.plane.C > 0.0:
            return 1.0 / self.plane.C
        return self.depth or DEFAULT_DEPTH

    @property
    def scale(self) -> float:
        """Factor of lengths in settings, which are meant for a target at DEFAULT_DEPTH."""
        return self.distance / DEFAULT_DEPTH

    def check_depth(self, plane_suffices: bool = False) -> None:
        """Check that the goal contains the depth of the target.

        Args:
            plane_suffices: accept a goal that contains the plane of the target instead.

        Raises:
            ConfigurationError: it does not.
        """
        if self.depth is None and not (plane_suffices and self.plane is not None):
            raise ConfigurationError(
                f"{self.name} contains no depth of the target: teach the goal again, or add "
                "`depth` (m) to its file"
            )

    @cached_property
    def cameras(self) -> dict[str, Goal]:
        """Goal of each camera, by name; the first is this one, of the control camera."""
        return {self.camera_name: self, **self.other_cameras}

    @classmethod
    def teach(
        cls,
        scheme: TeachableScheme | None,
        observation: Observation,
        name: str = "goal",
        depth: float | None = None,
        target: TargetGeometry | None = None,
    ) -> Goal:
        """Create a goal from an observation.

        Args:
            scheme: scheme whose features store their data in the goal; None to store only moments,
                kernel features and pose.
            observation: observation at the goal, from images, exact contours or points.
            name: name of the goal, for messages.
            depth: depth of the target, m; None to take it from the observation's plane.
            target: geometry of the target; None if it is unknown.

        Raises:
            ConfigurationError: the target is not visible, or neither depth nor plane is known.
        """
        if not observation.valid:
            by = f" by camera {observation.name}" if observation.name != CAMERA else ""
            reason = f"the target is not detected{by}: {observation.reason}"
            raise ConfigurationError(f"{name}: {reason}")
        try:
            taught = {} if scheme is None else {
                key: dict(entry) for key, entry in scheme.teach(observation).items()
            }  # fmt: skip
        except (ServoError, VisionError) as error:
            raise ConfigurationError(f"{name}: {error}") from error
        pose, plane = observation.world_T_camera, observation.plane
        if plane is None and depth is None and target is not None and pose is not None:
            plane = target.compute_plane(pose)
        if plane is None and depth is None:
            raise ConfigurationError(f"{name}: the target's depth is unknown; give the depth in m")
        depth = 1.0 / plane.C if depth is None else float(depth)
        joints = observation.joints
        values = {} if joints is None else {
            n: float(q) for n, q in zip(joints.names, joints.positions, strict=True)
        }  # fmt: skip
        goal = cls(
            name, values, pose, depth, plane, observation.moments,
            GoalKernel.from_observation(observation), observation.camera, taught, target, None,
            observation.name, marker=observation.marker,
        )  # fmt: skip
        return goal._add_other_cameras(observation) if observation.other_cameras else goal

    def _add_other_cameras(self, observation: Observation) -> Goal:
        """Return this goal with the goals of the other cameras of the observation.

        If the view of another camera does not determine the target's plane, the plane is computed
        from this goal.
        """
        goal = self if self.plane is not None else replace(self, plane=self.make_level_plane())
        others = {}
        for camera, view in observation.other_cameras.items():
            if view.plane is None and view.has_other_target:
                raise ConfigurationError(
                    f"{self.name}: camera {camera} has its own target, whose distance is unknown: "
                    "teach the goal with features that measure depth, or by an experiment, which "
                    "knows the target"
                )
            if view.plane is None and view.world_T_camera is not None:
                view = replace(view, plane=goal.compute_plane(view.world_T_camera))
            others[camera] = Goal.teach(None, view, self.name, None, self.target)
        return replace(self, other_cameras=others)

    def for_arm(self, arm: Arm) -> Goal:
        """Return the goal for this arm.

        The pose is computed from the joints. If the goal has no plane, the target's plane is
        assumed to be horizontal.

        Raises:
            ConfigurationError: the arm does not have one of the joints, a joint is missing or
                beyond its limits, or the camera's mounting has changed since teaching.
        """
        goal = self._compute_pose(arm) if self.joints else self
        if goal.plane is None and goal.world_T_camera is not None and goal.depth is not None:
            goal = replace(goal, plane=goal.make_level_plane())
        return goal

    def for_cameras(self, arms: Mapping[str, CameraKinematics]) -> Goal:
        """Return the goal for several cameras, the control camera first.

        A view that the goal lacks is computed from the geometry of the target, if it is known.

        Args:
            arms: kinematics of each camera, by name.

        Raises:
            ConfigurationError: see `for_arm`.
        """
        (name, arm), *rest = arms.items()
        stored, goal = self.cameras, self
        if name in self.other_cameras:
            goal = replace(self.other_cameras[name], joints=self.joints, features=self.features,
                           target=self.target)  # fmt: skip
        goal = replace(goal.for_arm(arm), camera_name=name, other_cameras={})
        q, others = goal.get_joints(arm.names), {}
        for camera, other in rest:
            if camera in stored:
                joints = self.joints if hasattr(other, "names") else {}
                others[camera] = replace(
                    stored[camera], joints=joints, other_cameras={}, camera_name=camera
                ).for_arm(other)
            elif goal.target is not None and q is not None and not isinstance(
                other, InverseCameraKinematics
            ):
                view = goal.predict_from_pose(np.array(other.pose(q)))
                others[camera] = replace(view, joints={}, camera=None, camera_name=camera)
        return replace(goal, other_cameras=others) if others else goal

    def find_posture(self, arm: Arm) -> np.ndarray | None:
        """Return joints (n,) at the goal: the stored ones, or a solution for the goal's pose.

        Return None if there are neither joints nor a pose. An error of the pose within
        REACH_TOLERANCE is accepted, because an arm with fewer than six joints rarely reaches a pose
        exactly.

        Raises:
            UnreachableError: there is no solution.
        """
        if self.joints or self.world_T_camera is None:
            return self.get_joints(arm.names)
        start = np.zeros(len(arm.names))
        return arm.inverse_kinematics(self.world_T_camera, start, REACH_TOLERANCE)

    def make_level_plane(self) -> Plane:
        """Return the horizontal target plane (normal along the base's z) at the goal's depth.

        Raises:
            ConfigurationError: the optical axis is almost parallel to the plane.
        """
        up = self.world_T_camera[2, :3]
        if abs(up[2]) < EDGE_ON_COSINE:
            raise ConfigurationError(
                f"{self.name}: at the goal the camera looks parallel to the table; teach a goal at "
                "which the camera points more downwards"
            )
        return Plane(*(up / (self.depth * up[2])).tolist())

    def compute_plane(self, world_T_camera: np.ndarray) -> Plane | None:
        """Return the target's plane in the frame of a camera at the pose `world_T_camera` (4, 4).

        The target is assumed to be at rest since teaching. Return None if the goal does not contain
        the plane, or if the camera is in the plane.
        """
        if self.plane is None or self.world_T_camera is None:
            return None
        # Every point X of the plane, in the goal's camera frame, satisfies (A, B, C) . X = 1.
        height, *plane = transform_plane(*self._plane_in_world, world_T_camera)
        return Plane(*plane) if height != 0.0 else None

    @cached_property
    def _plane_in_world(self) -> tuple[np.ndarray, float]:
        """Normal n (3,) and offset d of the plane in the arm's base: n . X = d."""
        normal = self.world_T_camera[:3, :3] @ np.array(self.plane)
        return normal, 1.0 + float(normal @ self.world_T_camera[:3, 3])

    def predict_from_pose(self, world_T_camera: np.ndarray) -> Goal:
        """Compute the goal for another camera pose and the same target, from the target's geometry.

        Raises:
            ConfigurationError: the geometry is unknown, or the target is not visible from that
                pose.
        """
        if self.target is None:
            raise ConfigurationError(f"{self.name} does not contain the target's geometry; teach "
                                     "the goal again")
        try:
            view = self.target.compute_outline(world_T_camera)
            plane = self.target.compute_plane(world_T_camera)
            moments = Moments.from_polygon(view, MAX_ORDER)
            depth = self.target.compute_depth(world_T_camera)
            kernel = None if self.kernel is None else self.kernel.predict(view)
        except (ServoError, VisionError) as error:
            raise ConfigurationError(
                f"{self.name}: the target is not visible from this pose ({error}); check the "
                "camera's mounting (camera_xyz, camera_rpy), or teach the goal with this mounting"
            ) from error
        return replace(
            self, world_T_camera=world_T_camera, depth=depth, plane=plane, moments=moments,
            kernel=kernel, features={}, mounting=None,
        )  # fmt: skip

    def compute_outline(self) -> np.ndarray:
        """Return the target's outline (n, 2) at the goal, normalised.

        The outline is computed from the target's geometry or, without it, as the ellipse that has
        the goal's moments. Without geometry and moments, the array is empty (0, 2).
        """
        if self.target is not None and self.world_T_camera is not None:
            with contextlib.suppress(ServoError):
                return self.target.compute_outline(self.world_T_camera)
        if self.moments is None:
            return np.zeros((0, 2))
        return ellipse_of(self.moments)

    def get_joints(self, names: Sequence[str]) -> np.ndarray | None:
        """Return the joints (n,) in the order of `names`; None if the goal contains no joints.

        Raises:
            ConfigurationError: a joint is missing.
        """
        if not self.joints:
            return None
        missing = [n for n in names if n not in self.joints]
        if missing:
            raise ConfigurationError(
                f"{self.name} has no value for the joint(s) {', '.join(missing)}; it has "
                f"{', '.join(self.joints)}: give a goal of this robot"
            )
        return np.array([self.joints[n] for n in names], float)

    def _compute_pose(self, arm: Arm) -> Goal:
        q = self.get_joints(arm.names)
        check_within_limits(q, arm, f"the goal {self.name}")
        pose = np.array(arm.pose(q))
        if self.world_T_camera is None:
            return replace(self, world_T_camera=pose)
        distance, angle = pose_difference(self.world_T_camera, pose)
        if distance < SAME_PLACE and angle < SAME_ANGLE:
            return replace(self, world_T_camera=pose)
        if self.target is not None:
            return replace(self, name=f"{self.name}, camera moved").predict_from_pose(pose)
        raise ConfigurationError(
            f"the goal {self.name} was taught with another mounting of the camera: at the goal's "
            f"joints the camera is now {1e3 * distance:.1f} mm and {np.degrees(angle):.1f} degrees "
            "away; teach the goal again (rosrun aras_visual_servo_controller teach)"
        )

    @classmethod
    def load(cls, path: str | Path) -> Goal:
        """Read a goal file.

        Raises:
            ConfigurationError: the file cannot be read, is too large or is not YAML, or a key is
                wrong.
        """
        text = read_text(path, ConfigurationError, "the goal")
        return _parse_goal(text, str(Path(path).expanduser()), Path(path).name)

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any], name: str = "goal") -> Goal:
        """Create a goal from a mapping that was read from YAML, and check it.

        Raises:
            ConfigurationError: an entry is wrong; the message names the key and what it must be.
        """
        goal, others = cls(name, **read_goal_fields(data, name)), {}
        for camera, entry in (data.get("cameras") or {}).items():
            other = cls.from_mapping(entry, f"{name}: cameras.{camera}")
            others[camera] = replace(other, camera_name=camera)
        return replace(goal, other_cameras=others)

    def to_yaml(self, heading: str = "") -> str:
        """Return the text of the goal file, with `heading` as a comment at its top."""
        return write_goal_text(self._get_attributes(), heading)

    def _get_attributes(self) -> dict[str, Any]:
        attributes = {one.name: getattr(self, one.name) for one in fields(self)}
        others = {name: goal._get_attributes() for name, goal in self.other_cameras.items()}
        return {**attributes, "other_cameras": others}


@lru_cache(maxsize=8)
def _parse_goal(text: str, where: str, name: str) -> Goal:
    """Read a goal from the text of its file; the result is cached."""
    return Goal.from_mapping(parse_yaml(text, where, ConfigurationError), name)
