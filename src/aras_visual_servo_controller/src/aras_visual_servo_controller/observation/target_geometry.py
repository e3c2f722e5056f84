"""Exact geometry of a target: its image from any camera pose, without noise.

A target consists of one or two overlapping thin boxes on the ground. The laboratory's target is a
square with a small patch at its edge; without the patch, the outline would look the same after a
quarter turn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from aras_visual_servo_base.compiled import jit
from aras_visual_servo_base.settings import build, parameter
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.moments import Moments

from ..errors import ConfigurationError, ServoError

Corner = tuple[float, float, float]
ELLIPSE_CORNERS = 32
# Upper bound of the number of corners that the outline of two boxes has: the corners of two convex
# outlines with up to eight corners, and the crossings of all pairs of their sides.
MAX_CORNERS = 8 + 8 + 8 * 8


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
        boxes = np.array(boxes, float)
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
        outline, pose = np.empty((MAX_CORNERS, 2)), np.asarray(world_T_camera, float)
        return outline[: compute_silhouette(self.boxes, self.ground, pose, outline)]


@jit("f8[:,:,:], f8, f8[:,:], f8[:,::1]")
def compute_silhouette(boxes, ground, world_T_camera, outline):
    """Compute the common outline of one or two boxes; see TargetGeometry.compute_outline.

    Only the parts above the height `ground` are visible. The corners (n, 2) are written into the
    first rows of `outline` (MAX_CORNERS, 2).

    Returns:
        The number n of corners.
    """
    corners = _compute_box_outline(boxes[0, 0], boxes[0, 1], ground, world_T_camera)
    if len(boxes) > 1:
        other = _compute_box_outline(boxes[1, 0], boxes[1, 1], ground, world_T_camera)
        corners = unite_star_shapes(corners, other)
    for k in range(len(corners)):
        outline[k, 0], outline[k, 1] = corners[k, 0], corners[k, 1]
    return len(corners)


@jit("f8[:], f8[:], f8, f8[:,:]")
def _compute_box_outline(low, high, ground, world_T_camera):
    """Return the convex outline of the part of a box above the ground."""
    points = np.empty((8, 2))
    for k in range(8):
        x = high[0] if k & 4 else low[0]
        y = high[1] if k & 2 else low[1]
        z = high[2] if k & 1 else max(low[2], ground)
        x, y, z = x - world_T_camera[0, 3], y - world_T_camera[1, 3], z - world_T_camera[2, 3]
        depth = x * world_T_camera[0, 2] + y * world_T_camera[1, 2] + z * world_T_camera[2, 2]
        if depth <= 0.0:
            raise ServoError(
                "the target is behind the camera and has no image: point the camera at the target"
            )
        for i in range(2):
            points[k, i] = (
                x * world_T_camera[0, i] + y * world_T_camera[1, i] + z * world_T_camera[2, i]
            ) / depth
    return convex_hull(points)


@jit("f8[:,:]")
def convex_hull(points):
    """Return the convex hull (n, 2) of points (m, 2), in counterclockwise order.

    The algorithm is Andrew's monotone chain.
    """
    count = len(points)
    order = np.empty(count, np.int64)  # indices of the points, sorted by x, then by y
    for k in range(count):
        place = k
        while place > 0:
            before = points[order[place - 1]]
            if before[0] < points[k, 0] or (
                before[0] == points[k, 0] and before[1] <= points[k, 1]
            ):
                break
            order[place] = order[place - 1]
            place -= 1
        order[place] = k
    hull, size = np.empty((2 * count, 2)), 0
    for chain in range(2):
        start = size
        for k in range(count):
            x, y = points[order[k if chain == 0 else count - 1 - k]]
            while size - start >= 2:
                ox, oy = hull[size - 2]
                ax, ay = hull[size - 1]
                if (ax - ox) * (y - oy) - (ay - oy) * (x - ox) > 0.0:
                    break
                size -= 1
            hull[size, 0], hull[size, 1] = x, y
            size += 1
        size -= 1
    return hull[:size].copy()


@jit("f8, f8, f8[:,:]", allocates=False)
def _is_inside(x, y, polygon):
    """Return whether a point is inside a convex polygon (k, 2)."""
    count = len(polygon)
    for k in range(count):
        after = k + 1 if k < count - 1 else 0
        u, v = polygon[after, 0] - polygon[k, 0], polygon[after, 1] - polygon[k, 1]
        if not u * (y - polygon[k, 1]) - v * (x - polygon[k, 0]) > 0.0:
            return False
    return True


@jit("f8[:,:], f8[:,:], f8[:,::1]")
def _find_crossings(one, other, crossings):
    """Write the points in which edges of two polygons cross into an array; return their number."""
    found = 0
    for i in range(len(one)):
        p, q = one[i], one[i + 1 if i < len(one) - 1 else 0]
        ux, uy = q[0] - p[0], q[1] - p[1]
        for j in range(len(other)):
            a, b = other[j], other[j + 1 if j < len(other) - 1 else 0]
            vx, vy, wx, wy = a[0] - b[0], a[1] - b[1], a[0] - p[0], a[1] - p[1]
            turn = ux * vy - vx * uy
            if abs(turn) < 1e-15:
                continue  # parallel edges do not cross
            s, t = (wx * vy - vx * wy) / turn, (ux * wy - uy * wx) / turn
            if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
                crossings[found, 0], crossings[found, 1] = p[0] + s * ux, p[1] + s * uy
                found += 1
    return found


@jit("f8[:,:], f8[:,:]")
def unite_star_shapes(one, other):
    """Return the outline (n, 2) of two overlapping convex polygons (k, 2) and (m, 2).

    The outline is star-shaped about a point that is common to both.

    Raises:
        ServoError: the polygons do not overlap.
    """
    size = len(one) * len(other)
    crossings, points = np.empty((size, 2)), np.empty((size + len(one) + len(other), 2))
    found = _find_crossings(one, other, crossings)
    if found < 2:
        raise ServoError("the two boxes of the target do not overlap in the image")
    x = y = 0.0
    inside = found
    for k in range(found):
        x, y = x + crossings[k, 0], y + crossings[k, 1]
    count = 0
    for polygon, further in ((one, other), (other, one)):
        for point in polygon:
            if _is_inside(point[0], point[1], further):
                x, y, inside = x + point[0], y + point[1], inside + 1
            else:
                points[count, 0], points[count, 1] = point[0], point[1]
                count += 1
    for k in range(found):
        points[count, 0], points[count, 1] = crossings[k, 0], crossings[k, 1]
        count += 1
    x, y = x / inside, y / inside
    angles, outline = np.empty(count), np.empty((count, 2))
    for k in range(count):  # sort the points by their angles
        angle = np.arctan2(points[k, 1] - y, points[k, 0] - x)
        place = k
        while place > 0 and angles[place - 1] > angle:
            angles[place] = angles[place - 1]
            outline[place, 0], outline[place, 1] = outline[place - 1, 0], outline[place - 1, 1]
            place -= 1
        angles[place] = angle
        outline[place, 0], outline[place, 1] = points[k, 0], points[k, 1]
    return outline


def ellipse_of(moments: Moments) -> np.ndarray:
    """Return the outline (n, 2) of the ellipse with the same area, centroid and second moments."""
    m, mu = moments, moments.mu
    spread = np.array([[mu(2, 0), mu(1, 1)], [mu(1, 1), mu(0, 2)]]) / m.m00
    squares, axes = np.linalg.eigh(spread)
    around = np.linspace(0.0, 2.0 * np.pi, ELLIPSE_CORNERS, endpoint=False)
    # A semi-axis of a filled ellipse is twice the standard deviation along the axis.
    reach = axes * (2.0 * np.sqrt(np.maximum(squares, 0.0)))
    return np.array([m.xg, m.yg]) + np.stack([np.cos(around), np.sin(around)], 1) @ reach.T
