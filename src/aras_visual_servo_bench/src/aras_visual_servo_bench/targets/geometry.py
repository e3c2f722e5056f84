"""Targets as exact geometry: what a perfect camera sees of them, and how they move.

A target's own frame has its z axis along the outward normal of its face. Normalised image
coordinates are x right, y down, on the plane one metre before the camera.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from aras_visual_servo_base.poses import exponential, inverse, matrix_from_xyz_rpy, rotation_vector
from aras_visual_servo_base.settings import check, parameter
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_controller.errors import ServoError
from aras_visual_servo_controller.observation.target_geometry import (
    TargetGeometry,
    unite_star_shapes,
)

from ..errors import ExperimentError, ViewError, require

ROUNDING = 1e-12  # m by which a point of a box's rim may lie beside it
POSE_TOLERANCE = 1e-9  # m, and of unit axes: a change of a pose by less is none
TIME_TOLERANCE = 1e-7  # s
MIN_DEPTH = 1e-3  # m before the camera; what is nearer has no view worth the name
IMAGE_FLIP = (1.0, -1.0)  # y of a picture runs down


class Target(ABC):
    """Something flat and dark that a camera can look at.

    is_solid: whether it is a SolidTarget. is_textured: whether it is a TexturedTarget.
    """

    is_solid = False
    is_textured = False

    @abstractmethod
    def outline(self, target_T_camera: np.ndarray) -> np.ndarray:
        """Silhouette (n, 2), normalised, in order; ViewError where it is behind the camera."""

    @abstractmethod
    def vertices(self) -> np.ndarray:
        """Its corners (n, 3) in its own frame, m, in order around it."""

    def points(self, target_T_camera: np.ndarray) -> np.ndarray | None:
        """The corners (n, 2), normalised, None: it has none; ViewError: one behind the camera."""
        return project(self.vertices(), target_T_camera)

    @property
    def height(self) -> float:
        """Of the face above the target's frame, m."""
        return float(self.vertices()[0, 2])

    def depth(self, target_T_camera: np.ndarray) -> float:
        """Z (m) where the optical axis meets the plane of the face."""
        return float((self.height - target_T_camera[2, 3]) / target_T_camera[2, 2])

    def plane(self, target_T_camera: np.ndarray) -> Plane:
        """1/Z = A x + B y + C of the face in this view."""
        distance = self.height - target_T_camera[2, 3]
        return Plane(*(target_T_camera[2, :3] / distance).tolist())

    def outline_plane(self, target_T_camera: np.ndarray) -> Plane:
        """The plane of what bounds its view, as moments need it; ViewError: none fits."""
        return self.plane(target_T_camera)


@dataclass(frozen=True, eq=False)
class BoxesTarget(Target):
    """Thin boxes on a ground, one or two that overlap in the view; see TargetGeometry."""

    geometry: TargetGeometry

    def outline(self, target_T_camera: np.ndarray) -> np.ndarray:
        """Outline of all boxes together."""
        try:
            return self.geometry.compute_outline(target_T_camera)
        except ServoError as error:
            raise ViewError(str(error)) from error

    def vertices(self) -> np.ndarray:
        """Corners of the upper faces' union, each at its height, in order around it."""
        return self._vertices

    @cached_property
    def _vertices(self) -> np.ndarray:
        boxes = self.geometry.boxes
        low, high = boxes[:, 0], boxes[:, 1]
        faces = [np.array([(a, b), (c, b), (c, d), (a, d)]) for (a, b, _), (c, d, _) in boxes]
        rim = faces[0] if len(faces) == 1 else unite_star_shapes(*faces)
        beyond = np.maximum(low[:, :2] - rim[:, None], rim[:, None] - high[:, :2]).max(axis=2)
        tops = np.where(beyond < ROUNDING, high[:, 2], -np.inf).max(axis=1)
        return np.column_stack([rim, tops])

    def depth(self, target_T_camera: np.ndarray) -> float:
        """Z (m) where the optical axis meets the surface that the geometry names."""
        return self.geometry.compute_depth(target_T_camera)

    def plane(self, target_T_camera: np.ndarray) -> Plane:
        """That surface in this view."""
        return self.geometry.compute_plane(target_T_camera)


@dataclass(frozen=True)
class PolygonTarget(Target):
    """A flat polygon without crossing edges: corners (x, y), m, in its own plane z = 0."""

    corners: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        require(len(self.corners) >= 3, "a target's polygon needs at least 3 corners")

    def outline(self, target_T_camera: np.ndarray) -> np.ndarray:
        """The projected corners: straight edges stay straight."""
        return project(self.vertices(), target_T_camera)

    def vertices(self) -> np.ndarray:
        """The corners at z = 0."""
        return np.array([(x, y, 0.0) for x, y in self.corners])


@dataclass(frozen=True)
class RoundTarget(PolygonTarget):
    """A disc, as a polygon of many corners: none of them is a point that could be tracked."""

    def points(self, target_T_camera: np.ndarray) -> np.ndarray | None:
        """None: a disc has no corners."""
        return None


# The demo's target in base_link, where robots/aras_visual_servo.urdf has it: its table is the
# plane z = 0.59, which hides the lower half of the square's plate.
ARAS = BoxesTarget(
    TargetGeometry.from_values(
        np.array(
            [
                [(-0.025, -0.025, 0.5895), (0.025, 0.025, 0.5905)],
                [(-0.0175, -0.0375, 0.59025), (0.0075, -0.0125, 0.59075)],
            ]
        ),
        ground=0.59,
        surface=0.5905,
    )
)


@dataclass(frozen=True)
class Motion:
    """How a target moves: a steady twist, a sine or a circle, steps, and a path, one on top of the
    other.

    velocity: (vx, vy, vz, wx, wy, wz) in world axes about its own origin, m/s and rad/s.
    amplitude: (x, y, z) m in world axes. frequency: Hz, of that and of the circle.
    circle: radius, m, of one in the world's level; it begins and ends at the target's place.
    step: (x, y, z) m in world axes that it jumps away at `begin`, and back and away again after
        every `hold` s; 0: once.
    path: waypoints (t, x, y, z) or (t, x, y, z, roll, pitch, yaw): t s after `begin`, the target is
        moved by so many m along, and turned by so many rad about, world axes. It goes evenly from
        its place to the first, and from each to the next, and rests at the last.
    begin: s; still until then.
    """

    velocity: tuple[float, float, float, float, float, float] = (0.0,) * 6
    amplitude: tuple[float, float, float] = (0.0,) * 3
    frequency: float = parameter(0.0, "Hz", least=0.0)
    circle: float = parameter(0.0, "m", least=0.0)
    step: tuple[float, float, float] = (0.0,) * 3
    hold: float = parameter(0.0, "s", least=0.0)
    path: tuple[tuple[float, ...], ...] = ()
    begin: float = parameter(0.0, "s", least=0.0)

    def __post_init__(self) -> None:
        check(self, ExperimentError, "motion")
        require(
            self.frequency > 0.0 or not (any(self.amplitude) or self.circle),
            "target motion: an amplitude, or a circle, needs a frequency above 0 Hz",
        )
        for waypoint in self.path:
            require(
                len(waypoint) in (4, 7),
                f"motion.path: {list(waypoint)} is no waypoint: give t, x, y, z, and roll, pitch, "
                "yaw where it turns",
            )
        times = [0.0, *(waypoint[0] for waypoint in self.path)]
        require(
            all(b > a for a, b in itertools.pairwise(times)),
            f"motion.path: its times are {', '.join(f'{t:g}' for t in times[1:])} s, must rise "
            "from above 0",
        )

    @property
    def is_static(self) -> bool:
        """Whether it never moves."""
        return not (
            any(self.velocity) or any(self.amplitude) or self.circle or any(self.step)
            or self.path
        )

    def compute_displacement(self, time: float) -> np.ndarray:
        """(4, 4) by which the target has moved at `time` (s), about its own origin."""
        moved = np.eye(4)
        since = time - self.begin
        if self.is_static or since < 0.0:
            return moved
        velocity = np.asarray(self.velocity)
        moved[:3, :3] = _to_rotation_matrix(velocity[3:] * since)
        phase = 2.0 * np.pi * self.frequency * since
        moved[:3, 3] = velocity[:3] * since + np.asarray(self.amplitude) * np.sin(phase)
        moved[:2, 3] += self.circle * np.array([np.sin(phase), 1.0 - np.cos(phase)])
        if not self.hold or int(since / self.hold) % 2 == 0:
            moved[:3, 3] += self.step
        if self.path:
            place, rotation = self._compute_path_displacement(since)
            moved[:3, 3] += place
            moved[:3, :3] = moved[:3, :3] @ rotation
        return moved

    def apply(self, pose: np.ndarray, time: float) -> np.ndarray:
        """world_T_target (4, 4) at `time` (s), of what lay at `pose` at time 0."""
        moved = self.compute_displacement(time)
        placed = pose.copy()
        placed[:3, :3] = moved[:3, :3] @ pose[:3, :3]
        placed[:3, 3] += moved[:3, 3]
        return placed

    def _compute_path_displacement(self, elapsed: float) -> tuple[np.ndarray, np.ndarray]:
        """Displacement (3,), m, and rotation (3, 3) by the path, s after `begin`."""
        times, poses = self._waypoints
        after = int(np.clip(np.searchsorted(times, elapsed), 1, len(times) - 1))
        before = after - 1
        share = np.clip((elapsed - times[before]) / (times[after] - times[before]), 0.0, 1.0)
        first, last = poses[before], poses[after]
        place = (1.0 - share) * first[:3, 3] + share * last[:3, 3]
        turn = share * rotation_vector(first[:3, :3].T @ last[:3, :3])
        return place, first[:3, :3] @ _to_rotation_matrix(turn)

    @cached_property
    def _waypoints(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """Times, s after `begin`, and displacements (4, 4), from the target's own place on."""
        poses = [matrix_from_xyz_rpy(p[1:4], p[4:] or (0.0,) * 3) for p in self.path]
        return np.array([0.0, *(p[0] for p in self.path)]), [np.eye(4), *poses]


def _to_rotation_matrix(turn: np.ndarray) -> np.ndarray:
    """(3, 3) of a rotation vector (3,), rad."""
    return exponential(np.append(np.zeros(3), turn))[:3, :3]


class PoseHistory:
    """Where a body of the simulated world was, as far as it is known."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._poses: list[np.ndarray] = []

    def add(self, time: float, pose: np.ndarray) -> None:
        """It is at world_T_body (4, 4) from `time` (s) on."""
        if not self._poses or np.abs(pose - self._poses[-1]).max() > POSE_TOLERANCE:
            self._times.append(time)
            self._poses.append(pose)

    def find_pose(self, time: float) -> np.ndarray | None:
        """Its pose (4, 4) at a time (s); None: before what is known."""
        count = bisect_right(self._times, time + TIME_TOLERANCE)
        return self._poses[count - 1] if count else None


@dataclass(frozen=True)
class PlacedTarget:
    """A target in the world, moving. pose: world_T_target (4, 4) at time 0. course: where it was
    since, of what the simulation moves; None: `motion` says it."""

    shape: Target
    pose: np.ndarray
    motion: Motion = Motion()
    pose_history: PoseHistory | None = None

    def world_T_target(self, time: float) -> np.ndarray:
        """(4, 4) at `time` (s)."""
        if (
            self.pose_history is not None
            and (known := self.pose_history.find_pose(time)) is not None
        ):
            return known
        if self.motion.is_static:
            return self.pose
        return self.motion.apply(self.pose, time)

    def target_T_camera(self, world_T_camera: np.ndarray, time: float = 0.0) -> np.ndarray:
        """target_T_camera (4, 4)."""
        return inverse(self.world_T_target(time)) @ world_T_camera

    def project(
        self,
        function: Callable[[np.ndarray], np.ndarray | None],
        pose: np.ndarray,
        time: float = 0.0,
    ) -> np.ndarray | None:
        """Places (n, 2), normalised, that a method of the shape gives for world_T_camera (4, 4).

        of: the shape's `points` or `outline`. None where the pose is unknown (NaN), or a place is
        not before the camera.
        """
        if not np.isfinite(pose).all():
            return None
        try:
            return function(self.target_T_camera(pose, time))
        except ViewError:
            return None


def project(points: np.ndarray, frame_T_camera: np.ndarray) -> np.ndarray:
    """Normalised coordinates (n, 2) of points (n, 3) of a frame.

    Raises:
        ViewError: one is not before the camera.
    """
    seen = (points - frame_T_camera[:3, 3]) @ frame_T_camera[:3, :3]
    if (seen[:, 2] < MIN_DEPTH).any():
        raise ViewError("the target is behind the camera: nothing to project")
    return seen[:, :2] / seen[:, 2:]
