"""Targets as exact geometry: what a perfect camera sees of them, and how they move.

A target's own frame has its z axis along the outward normal of its face. Normalised image
coordinates are x right, y down, on the plane one metre before the camera.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from aras_visual_servo_controller.arm.poses import inverse

from . import rigid
from .checked import require
from .errors import ViewError

NEAREST = 1e-3  # m before the camera; what is nearer has no view worth the name


class Target(ABC):
    """Something flat and dark that a camera can look at."""

    @abstractmethod
    def outline(self, target_T_camera: np.ndarray) -> np.ndarray:
        """Silhouette (n, 2), normalised, in order; ViewError where it is behind the camera."""

    @abstractmethod
    def vertices(self) -> np.ndarray:
        """Its corners (n, 3) in its own frame, m, in order around it."""

    def points(self, target_T_camera: np.ndarray) -> np.ndarray:
        """The corners (n, 2), normalised; ViewError where one is behind the camera."""
        return project(self.vertices(), target_T_camera)

    @property
    def height(self) -> float:
        """Of the face above the target's frame, m."""
        return float(self.vertices()[0, 2])

    def depth(self, target_T_camera: np.ndarray) -> float:
        """Z (m) where the optical axis meets the plane of the face."""
        return float((self.height - target_T_camera[2, 3]) / target_T_camera[2, 2])

    def plane(self, target_T_camera: np.ndarray) -> tuple[float, float, float]:
        """(A, B, C) with 1/Z = A x + B y + C of the face in this view."""
        normal = target_T_camera[2, :3]
        distance = self.height - target_T_camera[2, 3]
        return tuple(float(part / distance) for part in normal)


@dataclass(frozen=True)
class PlatesTarget(Target):
    """Thin boxes that overlap in the view, as the demo's square with a patch over one side.

    plates: lowest and highest corner of each, m. table: nothing below this height is seen, m.
    """

    plates: tuple[tuple[tuple[float, float, float], tuple[float, float, float]], ...]
    table: float = -np.inf

    def outline(self, target_T_camera: np.ndarray) -> np.ndarray:
        """Outline of two overlapping silhouettes."""
        square, patch = (self._silhouette(*plate, target_T_camera) for plate in self.plates)
        return _star_union(square, patch)

    def vertices(self) -> np.ndarray:
        """Upper corners of the first plate."""
        (x0, y0, _), (x1, y1, z) = self.plates[0]
        return np.array([(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)])

    def _silhouette(self, low: tuple, high: tuple, target_T_camera: np.ndarray) -> np.ndarray:
        heights = (max(low[2], self.table), high[2])
        corners = [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in heights]
        return _convex_hull(project(np.array(corners), target_T_camera))


@dataclass(frozen=True)
class PolygonTarget(Target):
    """A flat polygon without crossing edges: corners (x, y), m, in its own plane z = 0."""

    corners: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        require(len(self.corners) >= 3, "a target's polygon needs at least 3 corners")

    def outline(self, target_T_camera: np.ndarray) -> np.ndarray:
        """The projected corners: straight edges stay straight."""
        return self.points(target_T_camera)

    def vertices(self) -> np.ndarray:
        """The corners at z = 0."""
        return np.array([(x, y, 0.0) for x, y in self.corners])


# The demo's target in base_link, where robots/aras_visual_servo.urdf has it: its table is the
# plane z = 0.59, which hides the lower half of the square's plate.
ARAS = PlatesTarget(
    (
        ((-0.025, -0.025, 0.5895), (0.025, 0.025, 0.5905)),
        ((-0.0175, -0.0375, 0.59025), (0.0075, -0.0125, 0.59075)),
    ),
    table=0.59,
)


@dataclass(frozen=True)
class Motion:
    """How a target moves: a steady twist, and one harmonic on top of it.

    velocity: (vx, vy, vz, wx, wy, wz) in world axes about its own origin, m/s and rad/s.
    amplitude: (x, y, z) m in world axes. frequency: Hz. begin: s; still until then.
    """

    velocity: tuple[float, float, float, float, float, float] = (0.0,) * 6
    amplitude: tuple[float, float, float] = (0.0,) * 3
    frequency: float = 0.0
    begin: float = 0.0

    def __post_init__(self) -> None:
        require(self.frequency >= 0.0, f"target motion: frequency {self.frequency:g} Hz is below 0")
        require(
            self.frequency > 0.0 or not any(self.amplitude),
            "target motion: an amplitude needs a frequency above 0 Hz",
        )

    @property
    def still(self) -> bool:
        """Whether it never moves."""
        return not (any(self.velocity) or any(self.amplitude))

    def displacement(self, time: float) -> np.ndarray:
        """(4, 4) by which the target has moved at `time` (s), about its own origin."""
        moved = np.eye(4)
        since = max(time - self.begin, 0.0)
        if self.still or since == 0.0:
            return moved
        velocity = np.asarray(self.velocity)
        moved[:3, :3] = rigid.exponential((0.0, 0.0, 0.0, *(velocity[3:] * since)))[:3, :3]
        swing = np.sin(2.0 * np.pi * self.frequency * since)
        moved[:3, 3] = velocity[:3] * since + np.asarray(self.amplitude) * swing
        return moved


@dataclass(frozen=True)
class PlacedTarget:
    """A target in the world, moving. pose: world_T_target (4, 4) at time 0."""

    shape: Target
    pose: np.ndarray
    motion: Motion = Motion()

    def world_T_target(self, time: float) -> np.ndarray:
        """(4, 4) at `time` (s)."""
        if self.motion.still:
            return self.pose
        moved = self.motion.displacement(time)
        placed = self.pose.copy()
        placed[:3, :3] = moved[:3, :3] @ self.pose[:3, :3]
        placed[:3, 3] += moved[:3, 3]
        return placed

    def seen_from(self, world_T_camera: np.ndarray, time: float = 0.0) -> np.ndarray:
        """target_T_camera (4, 4)."""
        return inverse(self.world_T_target(time)) @ world_T_camera


def project(points: np.ndarray, frame_T_camera: np.ndarray) -> np.ndarray:
    """Normalised coordinates (n, 2) of points (n, 3) of a frame.

    Raises:
        ViewError: one is not before the camera.
    """
    seen = (points - frame_T_camera[:3, 3]) @ frame_T_camera[:3, :3]
    if (seen[:, 2] < NEAREST).any():
        raise ViewError("the target is behind the camera: nothing to project")
    return seen[:, :2] / seen[:, 2:]


def _cross(o: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    return (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0])


def _convex_hull(points: np.ndarray) -> np.ndarray:
    """Hull (n, 2) with positive turn (Andrew's monotone chain)."""
    ordered = sorted(map(tuple, points))
    hull: list[tuple] = []
    for chain in (ordered, ordered[::-1]):
        start = len(hull)
        for point in chain:
            while len(hull) - start >= 2 and _cross(hull[-2], hull[-1], point) <= 0.0:
                hull.pop()
            hull.append(point)
        hull.pop()
    return np.array(hull)


def _inside(point: np.ndarray, polygon: np.ndarray) -> bool:
    ends = np.roll(polygon, -1, axis=0)
    return all(_cross(a, b, point) > 0.0 for a, b in zip(polygon, ends, strict=True))


def _crossings(one: np.ndarray, other: np.ndarray) -> list[np.ndarray]:
    """Points where edges of two polygons cross."""
    found = []
    for a, b in zip(one, np.roll(one, -1, axis=0), strict=True):
        for c, d in zip(other, np.roll(other, -1, axis=0), strict=True):
            across = (b[0] - a[0]) * (c[1] - d[1]) - (b[1] - a[1]) * (c[0] - d[0])
            if abs(across) < 1e-15:
                continue
            u, v = c - a
            s = (u * (c[1] - d[1]) - v * (c[0] - d[0])) / across
            t = ((b[0] - a[0]) * v - (b[1] - a[1]) * u) / across
            if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
                found.append(a + s * (b - a))
    return found


def _star_union(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Outline of two overlapping convex polygons: star-shaped about a point they share."""
    crossings = _crossings(one, other)
    if len(crossings) < 2:
        raise ViewError("the plates of the target do not overlap in the picture")
    inner = [p for p in one if _inside(p, other)] + [p for p in other if _inside(p, one)]
    middle = np.mean([*crossings, *inner], axis=0)
    corners = [p for p in one if not _inside(p, other)]
    corners += [p for p in other if not _inside(p, one)]
    points = np.array([*corners, *crossings])
    angles = np.arctan2(points[:, 1] - middle[1], points[:, 0] - middle[0])
    return points[np.argsort(angles)]
