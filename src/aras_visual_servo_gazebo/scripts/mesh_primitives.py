"""Primitives of closed triangle meshes.

A *part* is an (n, 3, 3) float64 array of n triangles with three corners each, in m,
counter-clockwise as viewed from outside. Every primitive returns a watertight part. The mesh of a
link consists of several parts, which may overlap.

An *outline* is an (n, 2) float64 array, a simple counter-clockwise polygon, in m.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

#: Resolution of the corners of a mesh, grid points per metre. Corners are rounded, so that machines
#: with different last bits write the same file.
GRID_PER_METRE = 1_000_000


class MeshError(ValueError):
    """The parameters of a primitive do not describe a closed shape."""


# --------------------------------------------------------------------------- outlines


def circle(radius: float, segments: int, centre: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """Return a regular polygon with `segments` corners on a circle, (segments, 2)."""
    return _arc(centre, radius, 0.0, 2 * math.pi * (segments - 1) / segments, segments - 1)


def rectangle(x0: float, x1: float, y0: float, y1: float) -> np.ndarray:
    """Return an axis-aligned rectangle, (4, 2)."""
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])


def rounded_rectangle(
    x0: float, x1: float, y0: float, y1: float, radius: float, steps: int = 3
) -> np.ndarray:
    """Return a rectangle with rounded corners of `steps` chords each, (4 * (steps + 1), 2)."""
    return rounded_corners(rectangle(x0, x1, y0, y1), [radius] * 4, steps)


def rounded_corners(
    polygon: Sequence[tuple[float, float]], radii: Sequence[float], steps: int = 4
) -> np.ndarray:
    """Return a polygon with corner i rounded by the radius radii[i]; radius 0 keeps it sharp."""
    points = np.asarray(polygon, dtype=float)
    out: list[np.ndarray] = []
    for i, corner in enumerate(points):
        if radii[i] == 0:
            out.append(corner[None])
            continue
        back = points[i - 1] - corner
        ahead = points[(i + 1) % len(points)] - corner
        back /= np.linalg.norm(back)
        ahead /= np.linalg.norm(ahead)
        half = math.acos(max(-1.0, min(1.0, float(back @ ahead)))) / 2
        bisector = (back + ahead) / np.linalg.norm(back + ahead)
        centre = corner + bisector * radii[i] / math.sin(half)
        from_centre = corner + back * radii[i] / math.tan(half) - centre
        start = math.atan2(from_centre[1], from_centre[0])
        turn = math.pi - 2 * half
        # At a corner with an inner angle above 180°, the arc has the opposite direction.
        if back[0] * ahead[1] - back[1] * ahead[0] > 0:
            turn = -turn
        out.append(_arc(centre, radii[i], start, start + turn, steps))
    return np.concatenate(out)


def capsule(
    start: float, start_radius: float, end: float, end_radius: float, segments: int
) -> np.ndarray:
    """Return the convex hull (segments + 2, 2) of two circles whose centres are on the second axis.

    start, end: positions of the two centres on the second axis, with start < end.
    segments: number of chords of both arcs together.
    """
    distance = end - start
    if distance <= abs(start_radius - end_radius):
        raise MeshError("capsule: one circle contains the other; move the centres apart")
    lean = math.asin((start_radius - end_radius) / distance)
    half = segments // 2
    upper = _arc((0.0, end), end_radius, lean, math.pi - lean, half)
    lower = _arc((0.0, start), start_radius, math.pi - lean, 2 * math.pi + lean, half)
    return np.concatenate([upper, lower])


def slotted_square(
    size: float, opening: float, lip: float, cavity: float, depth: float
) -> np.ndarray:
    """Return the outline (36, 2) of a square aluminium profile with one T-slot in each side.

    opening, cavity: width of the slot at the surface, and its width inside.
    lip, depth: depth at which the slot widens, and depth at which it ends.
    """
    half = size / 2
    face = [
        (-half, -half),
        (-opening / 2, -half),
        (-opening / 2, -half + lip),
        (-cavity / 2, -half + lip),
        (-cavity / 2, -half + depth),
        (cavity / 2, -half + depth),
        (cavity / 2, -half + lip),
        (opening / 2, -half + lip),
        (opening / 2, -half),
    ]
    return _four_faces(face)


def grooved_square(size: float, opening: float, depth: float) -> np.ndarray:
    """Return the outline (20, 2) of a square profile with one rectangular groove in each side."""
    half, side = size / 2, opening / 2
    return _four_faces(
        [
            (-half, -half),
            (-side, -half),
            (-side, -half + depth),
            (side, -half + depth),
            (side, -half),
        ]
    )


def _four_faces(face: list[tuple[float, float]]) -> np.ndarray:
    out: list[tuple[float, float]] = []
    for _ in range(4):
        out += face
        face = [(-y, x) for x, y in face]  # rotate the outline by 90° to the next side
    return np.array(out)


def _arc(centre, radius: float, start: float, end: float, steps: int) -> np.ndarray:
    angles = [start + (end - start) * k / steps for k in range(steps + 1)]
    return np.array(
        [(centre[0] + radius * math.cos(a), centre[1] + radius * math.sin(a)) for a in angles]
    )


# --------------------------------------------------------------------------- solids


def loft(sections: Sequence[tuple[np.ndarray, float]]) -> np.ndarray:
    """Return the solid through outlines that are stacked along z.

    sections: pairs (outline, z) with increasing z; all outlines have the same number of corners. k
        outlines with m corners yield 2 m (k - 1) + 2 (m - 2) triangles.
    """
    count = len(sections[0][0])
    if any(len(outline) != count for outline, _ in sections):
        raise MeshError("loft: all outlines need the same number of corners")
    rings = [np.column_stack([outline, np.full(count, z)]) for outline, z in sections]
    triangles = []
    for low, high in zip(rings, rings[1:], strict=False):
        for i in range(count):
            j = (i + 1) % count
            triangles += [(low[i], low[j], high[j]), (low[i], high[j], high[i])]
    bottom, top = rings[0], rings[-1]
    triangles += [(bottom[a], bottom[c], bottom[b]) for a, b, c in _ears(sections[0][0])]
    triangles += [(top[a], top[b], top[c]) for a, b, c in _ears(sections[-1][0])]
    return np.array(triangles, dtype=float)


def extrude(outline: np.ndarray, z0: float, z1: float) -> np.ndarray:
    """Return a prism between two heights z whose base is an outline."""
    return loft([(outline, z0), (outline, z1)])


def box(x0: float, x1: float, y0: float, y1: float, z0: float, z1: float) -> np.ndarray:
    """Return an axis-aligned box of 12 triangles."""
    return extrude(rectangle(x0, x1, y0, y1), z0, z1)


def revolve(profile: Sequence[tuple[float, float]], segments: int) -> np.ndarray:
    """Return a solid of revolution about z with flat ends.

    profile: pairs (radius, z) with radius > 0 and non-decreasing z; two pairs with equal z yield a
        flat step.
    """
    return loft([(circle(radius, segments), z) for radius, z in profile])


def cylinder(radius: float, z0: float, z1: float, segments: int) -> np.ndarray:
    """Return a cylinder about z."""
    return revolve([(radius, z0), (radius, z1)], segments)


def _ears(outline: np.ndarray) -> list[tuple[int, int, int]]:
    """Triangulate a simple polygon by ear clipping.

    Return a triple of corner indices for each triangle, counter-clockwise.
    """
    points = [tuple(p) for p in np.asarray(outline, dtype=float)]
    remaining = list(range(len(points)))
    out = []
    while len(remaining) > 3:
        for k in range(len(remaining)):
            a, b, c = remaining[k - 1], remaining[k], remaining[(k + 1) % len(remaining)]
            if _turn(points[a], points[b], points[c]) <= 1e-15:
                continue
            others = (points[i] for i in remaining if i not in (a, b, c))
            if not any(_inside(p, points[a], points[b], points[c]) for p in others):
                out.append((a, b, c))
                del remaining[k]
                break
        else:
            raise MeshError("extrude: the outline crosses itself or is clockwise; reverse it")
    out.append(tuple(remaining))
    return out


def _turn(a, b, c) -> float:
    """Return twice the signed area of a triangle, which is positive for a left turn."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _inside(p, a, b, c) -> bool:
    return _turn(a, b, p) >= -1e-12 and _turn(b, c, p) >= -1e-12 and _turn(c, a, p) >= -1e-12


# --------------------------------------------------------------------------- placing


def along_x(part: np.ndarray) -> np.ndarray:
    """Rotate a part such that its z axis becomes x, x becomes y, and y becomes z."""
    return part[:, :, [2, 0, 1]]


def along_y(part: np.ndarray) -> np.ndarray:
    """Rotate a part such that its z axis becomes y, x becomes z, and y becomes x."""
    return part[:, :, [1, 2, 0]]


def move(part: np.ndarray, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """Translate a part by (x, y, z)."""
    return part + np.array([x, y, z])


def mirror(part: np.ndarray, axis: int) -> np.ndarray:
    """Mirror a part at the plane normal to axis 0, 1 or 2; its faces still point outwards."""
    out = part.copy()
    out[:, :, axis] *= -1.0
    return out[:, ::-1]


def both_sides(part: np.ndarray, axis: int) -> list[np.ndarray]:
    """Return a part and its mirror image."""
    return [part, mirror(part, axis)]


def on_grid(part: np.ndarray) -> np.ndarray:
    """Round the corners to the grid of GRID_PER_METRE and remove triangles without area."""
    out = np.round(part * GRID_PER_METRE) / GRID_PER_METRE + 0.0
    has_area = np.linalg.norm(np.cross(out[:, 1] - out[:, 0], out[:, 2] - out[:, 0]), axis=1) > 0
    return out[has_area]
