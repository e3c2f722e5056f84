"""Exact geometry of targets: shape, projection into a camera, and motion.

The z axis of a target frame is the outward normal of the target's face. Normalised image
coordinates (x right, y down) are coordinates in the plane one metre in front of the camera.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from aras_visual_servo_base.compiled import jit
from aras_visual_servo_base.poses import exponential, inverse, matrix_from_xyz_rpy, rotation_vector
from aras_visual_servo_base.settings import check, parameter
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_controller.errors import ServoError
from aras_visual_servo_controller.observation.target_geometry import (
    TargetGeometry,
    unite_star_shapes,
)

from ..errors import ExperimentError, OutOfViewError, require

ROUNDING = 1e-12  # maximum rounding error of a point on the edge of a box, m
# largest change of an element of a pose matrix at which the body counts as at rest
POSE_TOLERANCE = 1e-9
TIME_TOLERANCE = 1e-7  # s
DEFAULT_SIZE = (0.2, 0.2)  # size of a target if neither its file nor its settings give one, m
MIN_DEPTH = 1e-3  # minimum depth of a point that is projected, m
# Factors that convert (x, y) with y upwards to (x, y) with y downwards, and back.
IMAGE_FLIP = (1.0, -1.0)


class Target(ABC):
    """Geometry of a target; the default methods are for a flat dark shape on a white background.

    is_solid: whether the target is a SolidTarget.
    is_textured: whether the target is a TexturedTarget.
    """

    is_solid = False
    is_textured = False

    @abstractmethod
    def outline(self, target_T_camera: np.ndarray) -> np.ndarray:
        """Return the corners (n, 2) of the silhouette in the image, in order around it.

        The coordinates are normalised image coordinates.

        Raises:
            OutOfViewError: the target is behind the camera.
        """

    @abstractmethod
    def vertices(self) -> np.ndarray:
        """Return the corners (n, 3) of the target, in order around it, in the target frame, m."""

    def points(self, target_T_camera: np.ndarray) -> np.ndarray | None:
        """Return the feature points (n, 2) in normalised image coordinates.

        Return None if the target has no such points.

        Raises:
            OutOfViewError: a corner is behind the camera.
        """
        return project(self.vertices(), target_T_camera)

    @property
    def height(self) -> float:
        """Height of the face above the origin of the target frame, m."""
        return float(self.vertices()[0, 2])

    def depth(self, target_T_camera: np.ndarray) -> float:
        """Return the depth Z (m) at which the optical axis meets the plane of the face."""
        return float((self.height - target_T_camera[2, 3]) / target_T_camera[2, 2])

    def plane(self, target_T_camera: np.ndarray) -> Plane:
        """Return the plane 1/Z = A x + B y + C of the face, in the camera frame."""
        distance = self.height - target_T_camera[2, 3]
        return Plane(*(target_T_camera[2, :3] / distance).tolist())

    def outline_plane(self, target_T_camera: np.ndarray) -> Plane:
        """Return the plane that contains the points of the outline, in the camera frame.

        The interaction matrix of image moments depends on this plane.

        Raises:
            OutOfViewError: the points of the outline do not determine a plane.
        """
        return self.plane(target_T_camera)


@dataclass(frozen=True, eq=False)
class PlatesTarget(Target):
    """Target that consists of one thin box, or of two thin boxes whose images overlap."""

    geometry: TargetGeometry

    def outline(self, target_T_camera: np.ndarray) -> np.ndarray:
        """Project the outline of the union of all boxes."""
        try:
            return self.geometry.compute_outline(target_T_camera)
        except ServoError as error:
            raise OutOfViewError(str(error)) from error

    def vertices(self) -> np.ndarray:
        """Return the corners (n, 3) of the union of the upper faces of all boxes."""
        return self._vertices

    @cached_property
    def _vertices(self) -> np.ndarray:
        boxes = self.geometry.boxes
        low, high = boxes[:, 0], boxes[:, 1]
        faces = [np.array([(a, b), (c, b), (c, d), (a, d)]) for (a, b, _), (c, d, _) in boxes]
        union = faces[0] if len(faces) == 1 else unite_star_shapes(*faces)
        outside = np.maximum(low[:, :2] - union[:, None], union[:, None] - high[:, :2]).max(axis=2)
        tops = np.where(outside < ROUNDING, high[:, 2], -np.inf).max(axis=1)
        return np.column_stack([union, tops])

    def depth(self, target_T_camera: np.ndarray) -> float:
        """Return the depth Z (m) at which the optical axis meets the plane of the target."""
        return self.geometry.compute_depth(target_T_camera)

    def plane(self, target_T_camera: np.ndarray) -> Plane:
        """Return the plane of the target, in the camera frame."""
        return self.geometry.compute_plane(target_T_camera)


@dataclass(frozen=True)
class PolygonTarget(Target):
    """Flat polygon in the plane z = 0 of the target frame; its edges do not cross.

    corners: position (x, y) of each corner, m."""

    corners: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        require(len(self.corners) >= 3, "a target's polygon needs at least 3 corners")

    def outline(self, target_T_camera: np.ndarray) -> np.ndarray:
        """Project the corners of the polygon; its edges are straight in normalised coordinates."""
        return project(self.vertices(), target_T_camera)

    def vertices(self) -> np.ndarray:
        """Return the corners (n, 3), at z = 0."""
        return self._vertices

    @cached_property
    def _vertices(self) -> np.ndarray:
        vertices = np.array([(x, y, 0.0) for x, y in self.corners])
        vertices.setflags(write=False)
        return vertices


@dataclass(frozen=True)
class RoundTarget(PolygonTarget):
    """Disc, approximated by a polygon; the corners of the polygon are not feature points."""

    def points(self, target_T_camera: np.ndarray) -> np.ndarray | None:
        """Return None, because a disc has no corners."""
        return None


# Target of the demo in the frame base_link, with the values of robots/aras_visual_servo.urdf. The
# top of the table is the plane z = 0.59, so the lower half of the square plate is inside the table.
ARAS_BOXES = np.array([
    [(-0.025, -0.025, 0.5895), (0.025, 0.025, 0.5905)],
    [(-0.0175, -0.0375, 0.59025), (0.0075, -0.0125, 0.59075)],
])  # fmt: skip
ARAS = PlatesTarget(TargetGeometry.from_values(ARAS_BOXES, ground=0.59, surface=0.5905))


@dataclass(frozen=True)
class TargetMotion:
    """Motion of a target: the sum of a constant twist, a sine, a circle, steps and a path.

    velocity: constant twist (vx, vy, vz, wx, wy, wz) of the target's origin, in world axes, m/s and
        rad/s.
    amplitude: amplitude (x, y, z) of the sine, in world axes, m.
    frequency: frequency of the sine and of the circle, Hz.
    circle: radius of a horizontal circle through the target's initial position, m.
    step: displacement (x, y, z) of a jump at the time `begin`, in world axes, m.
    hold: time between two jumps, s; the jumps go alternately forth and back. 0: only one jump.
    path: waypoints (t, x, y, z) or (t, x, y, z, roll, pitch, yaw): time after `begin` (s),
        displacement (m) and rotation (rad) about world axes. The velocity is constant between two
        waypoints. The target starts at its initial pose and stops at the last waypoint.
    begin: time until which the target is at rest, s.
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
            "motion: amplitude and circle need a frequency above 0 Hz",
        )
        for waypoint in self.path:
            require(
                len(waypoint) in (4, 7),
                f"motion.path has the waypoint {list(waypoint)}, must be [t, x, y, z] or "
                "[t, x, y, z, roll, pitch, yaw]",
            )
        times = [0.0, *(waypoint[0] for waypoint in self.path)]
        require(
            all(b > a for a, b in itertools.pairwise(times)),
            f"motion.path: the times are {', '.join(f'{t:g}' for t in times[1:])} s, must be above "
            "0 and increase",
        )

    @property
    def is_static(self) -> bool:
        """True if the target never moves."""
        moves = (*self.velocity, *self.amplitude, self.circle, *self.step, *self.path)
        return not any(moves)

    def compute_displacement(self, time: float) -> np.ndarray:
        """Compute the displacement (4, 4) at `time` (s); the target rotates about its origin."""
        displacement = np.eye(4)
        elapsed = time - self.begin
        if self.is_static or elapsed < 0.0:
            return displacement
        velocity = np.asarray(self.velocity)
        displacement[:3, :3] = _to_rotation_matrix(velocity[3:] * elapsed)
        phase = 2.0 * np.pi * self.frequency * elapsed
        displacement[:3, 3] = velocity[:3] * elapsed + np.asarray(self.amplitude) * np.sin(phase)
        displacement[:2, 3] += self.circle * np.array([np.sin(phase), 1.0 - np.cos(phase)])
        if not self.hold or int(elapsed / self.hold) % 2 == 0:
            displacement[:3, 3] += self.step
        if self.path:
            translation, rotation = self._compute_path_displacement(elapsed)
            displacement[:3, 3] += translation
            displacement[:3, :3] = displacement[:3, :3] @ rotation
        return displacement

    def apply(self, pose: np.ndarray, time: float) -> np.ndarray:
        """Return world_T_target (4, 4) at `time` (s).

        pose: world_T_target (4, 4) at time 0."""
        displacement = self.compute_displacement(time)
        moved = pose.copy()
        moved[:3, :3] = displacement[:3, :3] @ pose[:3, :3]
        moved[:3, 3] += displacement[:3, 3]
        return moved

    def _compute_path_displacement(self, elapsed: float) -> tuple[np.ndarray, np.ndarray]:
        """Interpolate the path; return the displacement (3,), m, and the rotation (3, 3).

        elapsed: time since `begin`, s.
        """
        times, poses = self._waypoints
        after = int(np.clip(np.searchsorted(times, elapsed), 1, len(times) - 1))
        before = after - 1
        fraction = np.clip((elapsed - times[before]) / (times[after] - times[before]), 0.0, 1.0)
        first, last = poses[before], poses[after]
        translation = (1.0 - fraction) * first[:3, 3] + fraction * last[:3, 3]
        turn = fraction * rotation_vector(first[:3, :3].T @ last[:3, :3])
        return translation, first[:3, :3] @ _to_rotation_matrix(turn)

    @cached_property
    def _waypoints(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """Times (s after `begin`) and displacements (4, 4) of the path, including the start."""
        poses = [matrix_from_xyz_rpy(p[1:4], p[4:] or (0.0,) * 3) for p in self.path]
        return np.array([0.0, *(p[0] for p in self.path)]), [np.eye(4), *poses]


def _to_rotation_matrix(turn: np.ndarray) -> np.ndarray:
    """Convert a rotation vector (3,), rad, to a rotation matrix (3, 3)."""
    return exponential(np.append(np.zeros(3), turn))[:3, :3]


class PoseHistory:
    """Recorded poses of a body in the simulated world."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._poses: list[np.ndarray] = []

    def add(self, time: float, pose: np.ndarray) -> None:
        """Add the pose world_T_body (4, 4) that the body has from `time` (s) on."""
        if not self._poses or np.abs(pose - self._poses[-1]).max() > POSE_TOLERANCE:
            self._times.append(time)
            self._poses.append(pose)

    def find_pose(self, time: float) -> np.ndarray | None:
        """Return the pose (4, 4) at a time (s); return None before the first recorded pose."""
        count = bisect_right(self._times, time + TIME_TOLERANCE)
        return self._poses[count - 1] if count else None


@dataclass(frozen=True)
class PlacedTarget:
    """Target with its pose and motion in the world.

    shape: geometry of the target.
    pose: world_T_target (4, 4) at time 0.
    motion: motion of the target.
    pose_history: recorded poses, if the simulation moves the target; None: `motion` gives the pose.
    """

    shape: Target
    pose: np.ndarray
    motion: TargetMotion = TargetMotion()
    pose_history: PoseHistory | None = None

    def world_T_target(self, time: float) -> np.ndarray:
        """Return world_T_target (4, 4) at `time` (s)."""
        recorded = None if self.pose_history is None else self.pose_history.find_pose(time)
        if recorded is not None:
            return recorded
        if self.motion.is_static:
            return self.pose
        return self.motion.apply(self.pose, time)

    def target_T_camera(self, world_T_camera: np.ndarray, time: float = 0.0) -> np.ndarray:
        """Return the pose target_T_camera (4, 4) of a camera in the target frame at `time` (s)."""
        if self._static_target_T_world is not None:
            return self._static_target_T_world @ world_T_camera
        return inverse(self.world_T_target(time)) @ world_T_camera

    @cached_property
    def _static_target_T_world(self) -> np.ndarray | None:
        """Pose (4, 4) of the world in the frame of a target that never moves; None if it moves."""
        is_static = self.pose_history is None and self.motion.is_static
        return inverse(self.pose) if is_static else None

    def project(
        self,
        function: Callable[[np.ndarray], np.ndarray | None],
        pose: np.ndarray,
        time: float = 0.0,
    ) -> np.ndarray | None:
        """Project the points or the outline of the target into a camera.

        Args:
            function: method `points` or `outline` of `shape`.
            pose: world_T_camera (4, 4).
            time: simulated time, s.

        Returns:
            Points (n, 2) in normalised image coordinates; None if the pose is unknown (NaN) or if a
            point is behind the camera.
        """
        if not np.isfinite(pose).all():
            return None
        try:
            return function(self.target_T_camera(pose, time))
        except OutOfViewError:
            return None


@jit("f8[:,:], f8[:,:]")
def project(points, frame_T_camera):
    """Project points (n, 3) in a frame to normalised image coordinates (n, 2).

    Raises:
        OutOfViewError: a point is behind the camera or closer than MIN_DEPTH.
    """
    projected = np.empty((len(points), 2))
    for k in range(len(points)):
        x = points[k, 0] - frame_T_camera[0, 3]
        y = points[k, 1] - frame_T_camera[1, 3]
        z = points[k, 2] - frame_T_camera[2, 3]
        depth = x * frame_T_camera[0, 2] + y * frame_T_camera[1, 2] + z * frame_T_camera[2, 2]
        if depth < MIN_DEPTH:
            raise OutOfViewError("the target is behind the camera, so it cannot be projected")
        for i in range(2):
            projected[k, i] = (
                x * frame_T_camera[0, i] + y * frame_T_camera[1, i] + z * frame_T_camera[2, i]
            ) / depth
    return projected
