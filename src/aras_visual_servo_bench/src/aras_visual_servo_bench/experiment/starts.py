"""Start of a run: a camera pose, a random camera pose, or a camera pose relative to the goal."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from aras_visual_servo_base.poses import exponential, relative_pose, xyz_rpy_from_matrix
from aras_visual_servo_base.settings import check, parameter

from ..errors import ExperimentError, require
from ..targets.target_spec import PoseValues, Vector2
from .camera_specs import HALF_TURN

KINDS = ("turned", "back", "plane", "looking")
Vector3 = tuple[float, float, float]


@dataclass(frozen=True)
class RandomStart:
    """Random start with the complete target in view, drawn with the seed of the experiment.

    height: minimum and maximum height of the camera above the target, m.
    side: maximum offset of the camera from the target along the world's x and y, m.
    turn: maximum rotation about the vertical, from the camera's orientation at the goal, rad.
    tilt: maximum tilt from the camera's orientation at the goal, rad.
    margin: minimum distance of the target from the image border, px.
    attempts: maximum number of draws; if none of them gives a valid start, an error is raised.
    """

    height: Vector2 = parameter((0.15, 0.5), "m")
    side: float = parameter(0.1, "m", least=0.0)
    turn: float = parameter(2.967, "rad", least=0.0, most=HALF_TURN)  # 170 degrees
    tilt: float = parameter(0.0, "rad", least=0.0, most=HALF_TURN)
    margin: float = parameter(2.0, "px", least=0.0)
    attempts: int = parameter(500, least=1)

    def __post_init__(self) -> None:
        check(self, ExperimentError, "start")
        low, high = self.height
        require(
            0.0 < low <= high,
            f"start.height is {low:g} to {high:g} m, must be 0 < minimum <= maximum",
        )

    def __str__(self) -> str:
        low, high = self.height
        turns = f"rotated by up to {math.degrees(self.turn):.3g}°"
        tilts = f", tilted by up to {math.degrees(self.tilt):.3g}°" if self.tilt else ""
        return (f"random, camera {low:g} to {high:g} m above the target and up to {self.side:g} m "
                f"to the side, {turns}{tilts}")  # fmt: skip


@dataclass(frozen=True)
class CameraPoseSpec:
    """Pose of the camera's optical frame in the world: x, y, z (m), roll, pitch, yaw (rad)."""

    pose: PoseValues

    def __str__(self) -> str:
        x, y, z = (f"{value:.4g}" for value in self.pose[:3])
        roll, pitch, yaw = (f"{math.degrees(value):.4g}" for value in self.pose[3:])
        return f"camera at x {x}, y {y}, z {z} m, roll {roll}°, pitch {pitch}°, yaw {yaw}°"


@dataclass(frozen=True)
class RelativeStart:
    """Start relative to the camera pose at the goal; angles in degrees, lengths in m.

    kind: 'turned' (rotated about an axis of the camera frame), 'back' (moved back along the optical
        axis), 'plane' (rotated about the x axis of the target) or 'looking' (random position in a
        box, with the camera pointed at a random point near the target).
    angle: angle of the rotation, for 'turned' and 'plane'.
    axis: axis of the rotation in the camera frame, for 'turned'.
    distance: distance by which the camera is moved back, for 'back'.
    box: maximum offset of the camera along each axis of the camera frame, for 'looking'.
    radii: radii of circles around the target, for 'looking'; the optical axis goes through a random
        point on one of them.
    turn: maximum rotation about the optical axis, for 'looking'. Over consecutive seeds, the
        rotation increases linearly from -turn to turn.
    of: number of consecutive seeds in which the rotation goes from -turn to turn, for 'looking'.
    scatter: maximum additional random offset (m) and rotation (degrees), along and about each axis.
    """

    kind: str = parameter(choices=KINDS)
    angle: float = parameter(0.0, "degrees")
    axis: Vector3 = (0.0, 0.0, 1.0)
    distance: float = parameter(0.0, "m")
    box: Vector3 = parameter((0.6, 0.6, 0.15), "m")
    radii: tuple[float, ...] = parameter((0.08, 0.16, 0.24, 0.32), "m")
    turn: float = parameter(120.0, "degrees")
    of: int = parameter(100, least=1)
    scatter: tuple[float, float] = parameter((0.0, 0.0), least=0.0)

    def __post_init__(self) -> None:
        check(self, ExperimentError, "start")

    def __str__(self) -> str:
        return "the goal's pose, " + {
            "turned": (
                f"rotated by {self.angle:g}° about ({', '.join(f'{v:g}' for v in self.axis)})"
            ),
            "back": f"{self.distance:g} m back along the optical axis",
            "plane": f"rotated around the target by {self.angle:g}°",
            "looking": "moved within a box and pointed at a point near the target",
        }[self.kind]

    def compute_pose(self, goal: np.ndarray, target: np.ndarray, seed: int) -> tuple[float, ...]:
        """Compute the camera pose at the start: x, y, z (m), roll, pitch, yaw (rad) in the world.

        Args:
            goal: world_T_camera (4, 4) at the goal.
            target: world_T_target (4, 4).
            seed: seed of the random numbers.
        """
        random = np.random.default_rng((seed, 7919))
        angle = np.radians(self.angle)
        if self.kind == "turned":
            axis = np.asarray(self.axis) / np.linalg.norm(self.axis)
            pose = goal @ exponential((0.0, 0.0, 0.0, *(angle * axis)))
        elif self.kind == "back":
            pose = goal @ exponential((0.0, 0.0, -self.distance, 0.0, 0.0, 0.0))
        elif self.kind == "plane":
            turned = target @ exponential((0.0, 0.0, 0.0, angle, 0.0, 0.0))
            pose = turned @ relative_pose(target, goal)
        else:
            pose = self._draw_looking_pose(goal, target, seed, random)
        offset, turn = self.scatter
        if offset or turn:
            shift = random.uniform(-offset, offset, 3)
            angles = np.radians(random.uniform(-turn, turn, 3))
            pose = pose @ exponential((*shift, *angles))
        xyz, rpy = xyz_rpy_from_matrix(pose)
        return (*xyz, *rpy)

    def _draw_looking_pose(
        self, goal: np.ndarray, target: np.ndarray, seed: int, random: np.random.Generator
    ) -> np.ndarray:
        """Draw world_T_camera (4, 4) for the start 'looking', in a box around the goal.

        The method is that of Felton et al.: the optical axis goes through a random point on one of
        the circles around the target's origin, and the rotation about the optical axis increases
        linearly with the seed.
        """
        offset = random.uniform(-1.0, 1.0, 3) * self.box
        radius = random.choice(self.radii)
        azimuth = random.uniform(-np.pi, np.pi)
        on_circle = (radius * np.cos(azimuth), radius * np.sin(azimuth), 0.0)
        point = target[:3, 3] + target[:3, :3] @ on_circle
        position = goal[:3, 3] + goal[:3, :3] @ offset
        forward = (point - position) / np.linalg.norm(point - position)
        right = goal[:3, 0] - (goal[:3, 0] @ forward) * forward
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
        pose[:3, 3] = position
        part = (seed % self.of) / max(self.of - 1, 1)
        turn = np.radians(self.turn * (2.0 * part - 1.0))
        return pose @ exponential((0.0, 0.0, 0.0, 0.0, 0.0, turn))
