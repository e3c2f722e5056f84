"""A target as exact geometry: what a perfect camera would see of it, from any pose.

Thin boxes on a ground, one or two that overlap: the laboratory's square and the patch that gives
its outline a direction. Numbers come from goal files and experiments, none stand here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from aras_visual_servo_base.settings import build, parameter
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_camera.polygons import next_vertices

from ..errors import ConfigurationError, ServoError

Corner = tuple[float, float, float]
ELLIPSE_CORNERS = 32


@dataclass(frozen=True)
class GeometryEntry:
    """A target's geometry as it is written; see TargetGeometry."""

    boxes: tuple[tuple[Corner, Corner], ...]
    ground: float = parameter(-math.inf, infinite=True)
    surface: float | None = None


@dataclass(frozen=True, eq=False)
class TargetGeometry:
    """Boxes in the world (the arm's base), axes along the world's, seen above a level ground.

    Attributes:
        boxes: (n, 2, 3) lowest and highest corner of each of one or two boxes, m.
        ground: height below which nothing of them is seen, m.
        surface: height of the plane that the interaction matrices take the target for, m.
    """

    boxes: np.ndarray
    ground: float
    surface: float

    @classmethod
    def from_mapping(cls, data: Any, where: str = "target") -> TargetGeometry:
        """Check a mapping {boxes, ground, surface}; surface: top of the first box by default.

        Raises:
            ConfigurationError: beginning with `where`.
        """
        given = build(GeometryEntry, data, where, ConfigurationError)
        boxes = np.array(given.boxes).reshape(-1, 2, 3)
        surface = given.surface
        if surface is None:
            surface = boxes[0, 1, 2] if len(boxes) else 0.0
        return cls.from_values(boxes, given.ground, surface, where)

    @classmethod
    def from_values(
        cls, boxes: np.ndarray, ground: float, surface: float, where: str = "target"
    ) -> TargetGeometry:
        """See from_mapping."""
        if boxes.ndim != 3 or boxes.shape[1:] != (2, 3) or len(boxes) not in (1, 2):
            raise ConfigurationError(
                f"{where}: boxes must be one or two pairs of corners [[x, y, z], [x, y, z]]"
            )
        if not (np.isfinite(boxes).all() and np.isfinite(surface) and not np.isnan(ground)):
            raise ConfigurationError(f"{where}: a number is not finite")
        if not (boxes[:, 0] < boxes[:, 1]).all():
            raise ConfigurationError(f"{where}: the first corner of a box is its lowest")
        boxes.setflags(write=False)
        return cls(boxes, ground, surface)

    def to_mapping(self) -> dict[str, Any]:
        """Plain numbers for YAML."""
        return {"surface": float(self.surface), "ground": float(self.ground),
                "boxes": self.boxes.tolist()}  # fmt: skip

    def compute_depth(self, world_T_camera: np.ndarray) -> float:
        """Depth Z (m) of the surface where the optical axis meets it.

        Raises:
            ServoError: it meets it behind the camera, or nowhere.
        """
        down = world_T_camera[2, 2]
        depth = (self.surface - world_T_camera[2, 3]) / down if down != 0.0 else -1.0
        if not depth > 0.0:
            raise ServoError("the camera does not look at the target's plane")
        return float(depth)

    def compute_plane(self, world_T_camera: np.ndarray) -> Plane:
        """The surface in the optical frame, 1/Z = A x + B y + C.

        Raises:
            ServoError: the camera stands in it.
        """
        height = self.surface - world_T_camera[2, 3]
        if height == 0.0:
            raise ServoError("the camera stands in the target's plane")
        return Plane(*(world_T_camera[2, :3] / height).tolist())

    def compute_outline(self, world_T_camera: np.ndarray) -> np.ndarray:
        """Silhouette (n, 2) of all boxes together, normalised image coordinates.

        Raises:
            ServoError: a box is not in front of the camera, or the boxes do not overlap.
        """
        parts = [self._compute_silhouette(low, high, world_T_camera) for low, high in self.boxes]
        return parts[0] if len(parts) == 1 else unite_star_shapes(*parts)

    def _compute_silhouette(
        self, low: np.ndarray, high: np.ndarray, world_T_camera: np.ndarray
    ) -> np.ndarray:
        """Convex outline of the part of a box above the ground."""
        heights = (max(low[2], self.ground), high[2])
        corners = np.array(
            [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in heights]
        )
        seen = (corners - world_T_camera[:3, 3]) @ world_T_camera[:3, :3]
        if (seen[:, 2] <= 0.0).any():
            raise ServoError("the target is behind the camera: nothing to project")
        return convex_hull(seen[:, :2] / seen[:, 2:])


def _cross(o: Sequence[float], a: Sequence[float], b: Sequence[float]) -> float:
    return (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0])


def convex_hull(points: np.ndarray) -> np.ndarray:
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


def _are_inside(points: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """Which (n,) of the points (n, 2) lie within a convex polygon (k, 2)."""
    x, y = (points[:, None] - polygon).transpose(2, 0, 1)
    u, v = (next_vertices(polygon) - polygon).T
    return (u * y - v * x > 0.0).all(axis=1)


def _find_crossings(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Points (n, 2) where edges of two polygons cross."""
    along = next_vertices(one) - one
    (ux, uy), (vx, vy) = along.T[..., None], (other - next_vertices(other)).T
    wx, wy = (other - one[:, None]).transpose(2, 0, 1)
    turn = ux * vy - vx * uy
    known = np.where(np.abs(turn) < 1e-15, np.nan, turn)  # parallel edges cross nowhere
    s, t = (wx * vy - vx * wy) / known, (ux * wy - uy * wx) / known
    edge, across = np.nonzero((s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0))
    return one[edge] + s[edge, across, None] * along[edge]


def unite_star_shapes(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Outline of two overlapping convex polygons: star-shaped about a point they share."""
    crossings = _find_crossings(one, other)
    if len(crossings) < 2:
        raise ServoError("the two boxes of the target do not overlap in the image")
    in_other, in_one = _are_inside(one, other), _are_inside(other, one)
    middle = np.vstack([crossings, one[in_other], other[in_one]]).mean(axis=0)
    points = np.vstack([one[~in_other], other[~in_one], crossings])
    angles = np.arctan2(points[:, 1] - middle[1], points[:, 0] - middle[0])
    return points[np.argsort(angles)]


def ellipse_of(moments: Moments) -> np.ndarray:
    """Outline (n, 2) of the ellipse that has these moments: as large, as long and turned alike."""
    m, mu = moments, moments.mu
    spread = np.array([[mu(2, 0), mu(1, 1)], [mu(1, 1), mu(0, 2)]]) / m.m00
    squares, axes = np.linalg.eigh(spread)
    around = np.linspace(0.0, 2.0 * np.pi, ELLIPSE_CORNERS, endpoint=False)
    # Half an axis of a filled ellipse is twice the standard deviation along it.
    reach = axes * (2.0 * np.sqrt(np.maximum(squares, 0.0)))
    return np.array([m.xg, m.yg]) + np.stack([np.cos(around), np.sin(around)], 1) @ reach.T
