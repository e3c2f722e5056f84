"""Exact geometry of a target: its image from any camera pose, without noise.

A target consists of one or two overlapping thin boxes on the ground, such as the laboratory's
square and the patch that gives its outline a direction. The dimensions come from goal files and
experiments.
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
    """Geometry of a target in a file; see TargetGeometry."""

    boxes: tuple[tuple[Corner, Corner], ...]
    ground: float = parameter(-math.inf, infinite=True)
    surface: float | None = None


@dataclass(frozen=True, eq=False)
class TargetGeometry:
    """Boxes above a horizontal ground, parallel to the axes of the world (the arm's base).

    Attributes:
        boxes: (n, 2, 3) lowest and highest corner of each of one or two boxes, m.
        ground: height below which the boxes are invisible, m.
        surface: height of the target's plane, which is used for interaction matrices, m.
    """

    boxes: np.ndarray
    ground: float
    surface: float

    @classmethod
    def from_mapping(cls, data: Any, where: str = "target") -> TargetGeometry:
        """Create the geometry from a mapping {boxes, ground, surface} and check it.

        The default of `surface` is the top of the first box.

        Raises:
            ConfigurationError: a value is wrong; the message starts with `where`.
        """
        entry = build(GeometryEntry, data, where, ConfigurationError)
        boxes = np.array(entry.boxes).reshape(-1, 2, 3)
        surface = entry.surface
        if surface is None:
            surface = boxes[0, 1, 2] if len(boxes) else 0.0
        return cls.from_values(boxes, entry.ground, surface, where)

    @classmethod
    def from_values(
        cls, boxes: np.ndarray, ground: float, surface: float, where: str = "target"
    ) -> TargetGeometry:
        """Create the geometry from its values and check them; see `from_mapping`."""
        if boxes.ndim != 3 or boxes.shape[1:] != (2, 3) or len(boxes) not in (1, 2):
            raise ConfigurationError(
                f"{where}: boxes must be one or two pairs of corners [[x, y, z], [x, y, z]]"
            )
        if not (np.isfinite(boxes).all() and np.isfinite(surface) and not np.isnan(ground)):
            raise ConfigurationError(f"{where}: a number is not finite")
        if not (boxes[:, 0] < boxes[:, 1]).all():
            raise ConfigurationError(
                f"{where}: the first corner of a box must have its lowest coordinates"
            )
        boxes.setflags(write=False)
        return cls(boxes, ground, surface)

    def to_mapping(self) -> dict[str, Any]:
        """Return the geometry as numbers and lists for YAML."""
        return {"surface": float(self.surface), "ground": float(self.ground),
                "boxes": self.boxes.tolist()}  # fmt: skip

    def compute_depth(self, world_T_camera: np.ndarray) -> float:
        """Return the depth Z (m) at which the optical axis meets the surface.

        Raises:
            ServoError: the axis meets the surface behind the camera, or not at all.
        """
        down = world_T_camera[2, 2]
        depth = (self.surface - world_T_camera[2, 3]) / down if down != 0.0 else -1.0
        if not depth > 0.0:
            raise ServoError(
                "the camera does not look at the target's plane: point it at the target"
            )
        return float(depth)

    def compute_plane(self, world_T_camera: np.ndarray) -> Plane:
        """Return the plane of the surface in the optical frame, 1/Z = A x + B y + C.

        Raises:
            ServoError: the camera is in the surface.
        """
        height = self.surface - world_T_camera[2, 3]
        if height == 0.0:
            raise ServoError("the camera lies in the target's plane: move it above the target")
        return Plane(*(world_T_camera[2, :3] / height).tolist())

    def compute_outline(self, world_T_camera: np.ndarray) -> np.ndarray:
        """Return the common silhouette (n, 2) of all boxes, in normalised image coordinates.

        Raises:
            ServoError: a box is not in front of the camera, or the boxes do not overlap in the
                image.
        """
        parts = [self._compute_silhouette(low, high, world_T_camera) for low, high in self.boxes]
        return parts[0] if len(parts) == 1 else unite_star_shapes(*parts)

    def _compute_silhouette(
        self, low: np.ndarray, high: np.ndarray, world_T_camera: np.ndarray
    ) -> np.ndarray:
        """Return the convex outline of the part of a box above the ground."""
        heights = (max(low[2], self.ground), high[2])
        corners = np.array(
            [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in heights]
        )
        points = (corners - world_T_camera[:3, 3]) @ world_T_camera[:3, :3]
        if (points[:, 2] <= 0.0).any():
            raise ServoError(
                "the target is behind the camera and has no image: point the camera at the target"
            )
        return convex_hull(points[:, :2] / points[:, 2:])


def _cross(o: Sequence[float], a: Sequence[float], b: Sequence[float]) -> float:
    return (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0])


def convex_hull(points: np.ndarray) -> np.ndarray:
    """Return the convex hull (n, 2) of points, in counterclockwise order.

    The algorithm is Andrew's monotone chain.
    """
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
    """Return whether each of the points (n, 2) is inside a convex polygon (k, 2)."""
    x, y = (points[:, None] - polygon).transpose(2, 0, 1)
    u, v = (next_vertices(polygon) - polygon).T
    return (u * y - v * x > 0.0).all(axis=1)


def _find_crossings(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the points (n, 2) in which edges of two polygons cross."""
    along = next_vertices(one) - one
    (ux, uy), (vx, vy) = along.T[..., None], (other - next_vertices(other)).T
    wx, wy = (other - one[:, None]).transpose(2, 0, 1)
    turn = ux * vy - vx * uy
    divisor = np.where(np.abs(turn) < 1e-15, np.nan, turn)  # parallel edges do not cross
    s, t = (wx * vy - vx * wy) / divisor, (ux * wy - uy * wx) / divisor
    edge, across = np.nonzero((s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0))
    return one[edge] + s[edge, across, None] * along[edge]


def unite_star_shapes(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the outline of two overlapping convex polygons.

    The outline is star-shaped about a point that is common to both.
    """
    crossings = _find_crossings(one, other)
    if len(crossings) < 2:
        raise ServoError("the two boxes of the target do not overlap in the image")
    in_other, in_one = _are_inside(one, other), _are_inside(other, one)
    middle = np.vstack([crossings, one[in_other], other[in_one]]).mean(axis=0)
    points = np.vstack([one[~in_other], other[~in_one], crossings])
    angles = np.arctan2(points[:, 1] - middle[1], points[:, 0] - middle[0])
    return points[np.argsort(angles)]


def ellipse_of(moments: Moments) -> np.ndarray:
    """Return the outline (n, 2) of the ellipse with the same area, centroid and second moments."""
    m, mu = moments, moments.mu
    spread = np.array([[mu(2, 0), mu(1, 1)], [mu(1, 1), mu(0, 2)]]) / m.m00
    squares, axes = np.linalg.eigh(spread)
    around = np.linspace(0.0, 2.0 * np.pi, ELLIPSE_CORNERS, endpoint=False)
    # A semi-axis of a filled ellipse is twice the standard deviation along it.
    reach = axes * (2.0 * np.sqrt(np.maximum(squares, 0.0)))
    return np.array([m.xg, m.yg]) + np.stack([np.cos(around), np.sin(around)], 1) @ reach.T
