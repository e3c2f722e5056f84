"""Where a run starts: a pose of the camera, one drawn at random, or one relative to the goal's."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from aras_visual_servo_base.poses import exponential, relative_pose, xyz_rpy_from_matrix
from aras_visual_servo_base.settings import check, parameter

from ..errors import ExperimentError, require
from ..targets.target_spec import PoseValues, Vector2
from .cameras import HALF_TURN

# Of a RelativeStart.
KINDS = ("turned", "back", "plane", "looking")
Vector3 = tuple[float, float, float]


@dataclass(frozen=True)
class Sampler:
    """Draws starts from which the target is wholly in view, with the experiment's seed.

    height: of the camera above the target, least and greatest, m. side: greatest offset along
    the world's x and y, m. turn: greatest turn about the vertical from the goal's heading, rad.
    tilt: greatest lean from the goal's attitude, rad. margin: of the view, px from each border.
    attempts: after which the sampler gives up.
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
        require(0.0 < low <= high, f"start.height is {low:g} to {high:g}, must rise from above 0 m")

    def __str__(self) -> str:
        low, high = self.height
        turns = f"turned by up to {math.degrees(self.turn):.3g}°"
        tilts = f", tilted by up to {math.degrees(self.tilt):.3g}°" if self.tilt else ""
        return (f"drawn, camera {low:g} to {high:g} m above the target and up to {self.side:g} m "
                f"beside it, {turns}{tilts}")  # fmt: skip


@dataclass(frozen=True)
class CameraPose:
    """A pose of the camera's optical frame in the world: x, y, z (m), roll, pitch, yaw (rad)."""

    pose: PoseValues

    def __str__(self) -> str:
        x, y, z = (f"{value:.4g}" for value in self.pose[:3])
        roll, pitch, yaw = (f"{math.degrees(value):.4g}" for value in self.pose[3:])
        return f"camera at x {x}, y {y}, z {z} m, roll {roll}°, pitch {pitch}°, yaw {yaw}°"


@dataclass(frozen=True)
class RelativeStart:
    """How a start is found from the goal's pose; angles in degrees, lengths in m.

    kind: 'turned' (about an axis of its own), 'back' (along the optical axis), 'plane' (gone round
        the target: its plane is turned about its x axis) or 'looking' (see `_draw_looking_pose`).
    angle: of turned and plane. axis: in the camera's frame, of turned. distance: of back.
    box, radii, turn: of looking: greatest offset, circles of the points looked at, turn about the
        optical axis, which is spaced evenly over `of` seeds.
    scatter: greatest additional offset (m) and turn about each axis, drawn by the seed.
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
            "turned": f"turned by {self.angle:g}° about ({', '.join(f'{v:g}' for v in self.axis)})",
            "back": f"{self.distance:g} m back along the optical axis",
            "plane": f"gone round the target by {self.angle:g}°",
            "looking": "moved in a box, looking at a point near the target",
        }[self.kind]

    def compute_pose(self, goal: np.ndarray, target: np.ndarray, seed: int) -> tuple[float, ...]:
        """x, y, z (m), roll, pitch, yaw (rad) in the world, of the goal's and target's (4, 4)."""
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
        """In a box about the goal, looking at a point of a circle on the target, turned.

        The protocol of Felton and others: the point lies on one of the circles, the turn about the
        optical axis runs linearly over the seeds.
        """
        offset = random.uniform(-1.0, 1.0, 3) * self.box
        radius = random.choice(self.radii)
        around = random.uniform(-np.pi, np.pi)
        on_circle = (radius * np.cos(around), radius * np.sin(around), 0.0)
        point = target[:3, 3] + target[:3, :3] @ on_circle
        place = goal[:3, 3] + goal[:3, :3] @ offset
        forward = (point - place) / np.linalg.norm(point - place)
        right = goal[:3, 0] - (goal[:3, 0] @ forward) * forward
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
        pose[:3, 3] = place
        part = (seed % self.of) / max(self.of - 1, 1)
        turn = np.radians(self.turn * (2.0 * part - 1.0))
        return pose @ exponential((0.0, 0.0, 0.0, 0.0, 0.0, turn))
