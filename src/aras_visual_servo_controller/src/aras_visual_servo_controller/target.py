"""The target of the demo as exact geometry: what a perfect camera would see of it.

Two thin black plates on the table, a square and a patch over one of its sides, which gives the
outline an orientation. Used to make the desired features before there is a camera to teach them
with, and by the tests.
"""

import numpy as np

from .errors import ServoError
from .kinematics import Kinematics

TABLE_HEIGHT = 0.59

# Corners (lowest, highest) of the plates in the world, m. The robot description places them in a
# frame with x along the world's -y, y up and z along the world's -x.
PLATES = (
    ((-0.025, -0.025, 0.5895), (0.025, 0.025, 0.5905)),
    ((-0.0175, -0.0375, 0.59025), (0.0075, -0.0125, 0.59075)),
)
SURFACE_HEIGHT = 0.5905


def target_depth(world_T_optical: np.ndarray) -> float:
    """Depth Z (m) of the square's surface where the optical axis meets it."""
    return float((SURFACE_HEIGHT - world_T_optical[2, 3]) / world_T_optical[2, 2])


def outline(world_T_optical: np.ndarray) -> np.ndarray:
    """Silhouette (n, 2) of both plates together in normalised image coordinates.

    Raises:
        ServoError: a plate is not in front of the camera.
    """
    square, patch = (_silhouette(low, high, world_T_optical) for low, high in PLATES)
    return _star_union(square, patch)


def desired_view(
    joints: np.ndarray, kinematics: Kinematics | None = None
) -> tuple[np.ndarray, float]:
    """Outline (n, 2) and depth Z* (m) that the camera has at these joints (6,)."""
    pose = (kinematics if kinematics is not None else Kinematics()).pose(joints)
    return outline(pose), target_depth(pose)


def _silhouette(low: tuple, high: tuple, world_T_optical: np.ndarray) -> np.ndarray:
    """Convex outline of the part of a box above the table."""
    heights = (max(low[2], TABLE_HEIGHT), high[2])
    corners = np.array(
        [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in heights]
    )
    seen = (corners - world_T_optical[:3, 3]) @ world_T_optical[:3, :3]
    if (seen[:, 2] <= 0.0).any():
        raise ServoError("the target is behind the camera: nothing to project")
    return _convex_hull(seen[:, :2] / seen[:, 2:])


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
            matrix = np.column_stack([b - a, c - d])
            if abs(np.linalg.det(matrix)) < 1e-15:
                continue
            s, t = np.linalg.solve(matrix, c - a)
            if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
                found.append(a + s * (b - a))
    return found


def _star_union(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Outline of two overlapping convex polygons: star-shaped about a point they share."""
    crossings = _crossings(one, other)
    if len(crossings) < 2:
        raise ServoError("the two plates of the target do not overlap in the image")
    inner = [p for p in one if _inside(p, other)] + [p for p in other if _inside(p, one)]
    middle = np.mean([*crossings, *inner], axis=0)
    corners = [p for p in one if not _inside(p, other)]
    corners += [p for p in other if not _inside(p, one)]
    points = np.array([*corners, *crossings])
    angles = np.arctan2(points[:, 1] - middle[1], points[:, 0] - middle[0])
    return points[np.argsort(angles)]
