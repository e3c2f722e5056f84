"""Closed triangle meshes from a handful of primitives.

A *part* is an (n, 3, 3) float64 array: n triangles, three corners each, metres, counter-clockwise
seen from outside. Every primitive returns a watertight part; a link's mesh is several parts
concatenated, which may overlap as bolted pieces of a machine do.

An *outline* is an (n, 2) float64 array, a simple polygon, counter-clockwise, metres.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

#: Corners are put on this grid (1 um), so that the last bit of a cosine never reaches a file.
GRID_PER_METRE = 1_000_000


class MeshError(ValueError):
    """A shape that has no inside: says which primitive and what to change."""


# --------------------------------------------------------------------------- outlines


def circle(radius: float, segments: int, centre: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """Regular polygon of `segments` corners on a circle, shape (segments, 2)."""
    return _arc(centre, radius, 0.0, 2 * math.pi * (segments - 1) / segments, segments - 1)


def rectangle(x0: float, x1: float, y0: float, y1: float) -> np.ndarray:
    """Axis-aligned rectangle, shape (4, 2)."""
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])


def rounded_rectangle(
    x0: float, x1: float, y0: float, y1: float, radius: float, steps: int = 3
) -> np.ndarray:
    """Rectangle with quarter-circle corners of `steps` chords each, shape (4 * (steps + 1), 2)."""
    return rounded_corners(rectangle(x0, x1, y0, y1), [radius] * 4, steps)


def rounded_corners(
    polygon: Sequence[tuple[float, float]], radii: Sequence[float], steps: int = 4
) -> np.ndarray:
    """Polygon whose corner i is replaced by an arc of radii[i] (0 keeps it sharp)."""
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
        if back[0] * ahead[1] - back[1] * ahead[0] > 0:  # a reflex corner turns the other way
            turn = -turn
        out.append(_arc(centre, radii[i], start, start + turn, steps))
    return np.concatenate(out)


def capsule(
    start: float, start_radius: float, end: float, end_radius: float, segments: int
) -> np.ndarray:
    """Hull of two circles on the second axis: the outline of a crank arm.

    start, end: positions of the circle centres along the second axis, start < end.
    Returns (segments + 2, 2): `segments` chords in all, plus the two straight sides.
    """
    distance = end - start
    if distance <= abs(start_radius - end_radius):
        raise MeshError("capsule: one circle swallows the other; move the centres apart")
    lean = math.asin((start_radius - end_radius) / distance)
    half = segments // 2
    upper = _arc((0.0, end), end_radius, lean, math.pi - lean, half)
    lower = _arc((0.0, start), start_radius, math.pi - lean, 2 * math.pi + lean, half)
    return np.concatenate([upper, lower])


def slotted_square(
    size: float, opening: float, lip: float, cavity: float, depth: float
) -> np.ndarray:
    """Square aluminium profile with one T-slot a face, shape (36, 2).

    opening, cavity: widths of the slot at the face and inside; lip, depth: where it widens, ends.
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
    """Square profile with one plain groove a face, shape (20, 2)."""
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
        face = [(-y, x) for x, y in face]  # the next face, a quarter turn on
    return np.array(out)


def _arc(centre, radius: float, start: float, end: float, steps: int) -> np.ndarray:
    angles = [start + (end - start) * k / steps for k in range(steps + 1)]
    return np.array(
        [(centre[0] + radius * math.cos(a), centre[1] + radius * math.sin(a)) for a in angles]
    )


# --------------------------------------------------------------------------- solids


def loft(sections: Sequence[tuple[np.ndarray, float]]) -> np.ndarray:
    """Solid through outlines of equal length stacked upwards along z.

    sections: (outline, z) pairs with rising z. Returns a part of 2 m (k - 1) + 2 (m - 2) triangles
    for k outlines of m corners.
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
    """Prism over an outline between two heights."""
    return loft([(outline, z0), (outline, z1)])


def box(x0: float, x1: float, y0: float, y1: float, z0: float, z1: float) -> np.ndarray:
    """Axis-aligned box, 12 triangles."""
    return extrude(rectangle(x0, x1, y0, y1), z0, z1)


def revolve(profile: Sequence[tuple[float, float]], segments: int) -> np.ndarray:
    """Turned piece about z: radii along rising z, flat ends.

    profile: (radius > 0, z) pairs with rising z (equal z makes a flat step).
    """
    return loft([(circle(radius, segments), z) for radius, z in profile])


def cylinder(radius: float, z0: float, z1: float, segments: int) -> np.ndarray:
    """Cylinder about z."""
    return revolve([(radius, z0), (radius, z1)], segments)


def _ears(outline: np.ndarray) -> list[tuple[int, int, int]]:
    """Triangulate a simple polygon by clipping ears; counter-clockwise triples of indices."""
    points = [tuple(p) for p in np.asarray(outline, dtype=float)]
    left = list(range(len(points)))
    out = []
    while len(left) > 3:
        for k in range(len(left)):
            a, b, c = left[k - 1], left[k], left[(k + 1) % len(left)]
            if _turn(points[a], points[b], points[c]) <= 1e-15:
                continue
            others = (points[i] for i in left if i not in (a, b, c))
            if not any(_inside(p, points[a], points[b], points[c]) for p in others):
                out.append((a, b, c))
                del left[k]
                break
        else:
            raise MeshError("extrude: the outline crosses itself or runs clockwise")
    out.append(tuple(left))
    return out


def _turn(a, b, c) -> float:
    """Twice the signed area of a triangle: positive for a left turn."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _inside(p, a, b, c) -> bool:
    return _turn(a, b, p) >= -1e-12 and _turn(b, c, p) >= -1e-12 and _turn(c, a, p) >= -1e-12


# --------------------------------------------------------------------------- placing


def along_x(part: np.ndarray) -> np.ndarray:
    """Turn a part so that its z becomes x, its x becomes y, its y becomes z."""
    return part[:, :, [2, 0, 1]]


def along_y(part: np.ndarray) -> np.ndarray:
    """Turn a part so that its z becomes y, its x becomes z, its y becomes x."""
    return part[:, :, [1, 2, 0]]


def move(part: np.ndarray, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """Shift a part by (x, y, z)."""
    return part + np.array([x, y, z])


def mirror(part: np.ndarray, axis: int) -> np.ndarray:
    """Mirror a part through the plane of an axis (0, 1, 2), keeping its faces outward."""
    out = part.copy()
    out[:, :, axis] *= -1.0
    return out[:, ::-1]


def both_sides(part: np.ndarray, axis: int) -> list[np.ndarray]:
    """The part and its mirror image."""
    return [part, mirror(part, axis)]


def on_grid(part: np.ndarray) -> np.ndarray:
    """Round the corners to GRID_PER_METRE and drop triangles that vanish by it."""
    out = np.round(part * GRID_PER_METRE) / GRID_PER_METRE + 0.0
    keep = np.linalg.norm(np.cross(out[:, 1] - out[:, 0], out[:, 2] - out[:, 0]), axis=1) > 0
    return out[keep]
