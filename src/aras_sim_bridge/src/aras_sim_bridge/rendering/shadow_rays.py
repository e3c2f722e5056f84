"""Rays from surfaces to lamps, which find the shadows.

Both sides of a triangle cast shadows, unless it is transparent.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from aras_visual_servo_base.compiled import jit_inline

from .lamps import KIND, RADIUS, direction_to_lamp

# Results of a ray, which may be combined with `|`. A ray is MIXED if it has no start, because the
# ray of the pixel does not meet the plane of the triangle.
LIT, DARK, MIXED = 1, 2, 3
# Offset of the start of a shadow ray from the surface: OFF (m) plus OFF_FAR times the distance from
# the camera. The offset is needed because mesh coordinates have single precision.
OFF, OFF_FAR = 2e-5, 2e-6


class ShadowCasters(NamedTuple):
    """Clusters of triangles that may block shadow rays.

    Attributes:
        optical_T_link: (rows, 4, 4) poses of the links in the optical frame.
        part: (C,) number of each cluster's visual.
        row: (C,) row of each cluster's link.
        first, count, centre, half: first triangle, number of triangles and bounding box of each
            cluster, see Clusters.
        corners: (T, 3, 3) corners of the triangles in the link frame, m.
    """

    optical_T_link: np.ndarray
    part: np.ndarray
    row: np.ndarray
    first: np.ndarray
    count: np.ndarray
    centre: np.ndarray
    half: np.ndarray
    corners: np.ndarray


@jit_inline
def _make_basis(d, e):
    """Write to the rows of e (2, 3) two unit vectors perpendicular to d and to each other."""
    k = 0 if abs(d[0]) < 0.6 else 1
    squared = 1.0 - d[k] * d[k]
    length = np.sqrt(squared)
    for j in range(3):
        e[0, j] = ((1.0 if j == k else 0.0) - d[k] * d[j]) / length
    e[1, 0] = d[1] * e[0, 2] - d[2] * e[0, 1]
    e[1, 1] = d[2] * e[0, 0] - d[0] * e[0, 2]
    e[1, 2] = d[0] * e[0, 1] - d[1] * e[0, 0]


@jit_inline
def is_beam_in_box(T, r, centre, half, n, point, radius, d, far, growth):
    """Return whether a beam may touch box n, which is given in the frame of link r.

    The beam extends from `point` along the unit vector d over the distance `far`. Its radius is
    `radius` at the start and increases by `growth` m per metre.
    """
    low, high = 0.0, far
    wide = 0.0
    middle = 0.0
    for k in range(3):
        # Each pass of the loop adds one axis: `middle` becomes the distance along d from `point` to
        # the centre of the box, and `wide` the square of half the box's diagonal.
        at = T[r, k, 0] * centre[n, 0] + T[r, k, 1] * centre[n, 1] + T[r, k, 2] * centre[n, 2]
        middle += (at + T[r, k, 3] - point[k]) * d[k]
        wide += half[n, k] * half[n, k]
    wide = radius + growth * max(min(middle + np.sqrt(wide), far), 0.0)
    for k in range(3):
        o = s = 0.0
        for j in range(3):
            o += T[r, j, k] * (point[j] - T[r, j, 3])
            s += T[r, j, k] * d[j]
        o -= centre[n, k]
        reach = half[n, k] + wide
        if abs(s) < 1e-12:
            if abs(o) > reach:
                high = -1.0
        else:
            a, b = (-reach - o) / s, (reach - o) / s
            low, high = max(low, min(a, b)), min(high, max(a, b))
    # The beam may touch the box at the distances low..high. It misses the box if this interval is
    # empty.
    return low <= high


@jit_inline
def _is_blocked(p, d, far, skip, own, own_distance, candidates, candidate_count, casters):
    """Return whether a cluster in `candidates[:candidate_count]` blocks the ray from p along d.

    The ray ends at p + far * d. Clusters of the visual `skip` are ignored. Clusters of the visual
    `own`, to which p belongs, are ignored up to the distance `own_distance` (m), because p is in
    the plane of its triangle, but may be outside the triangle.
    A cluster that blocks the ray is moved to the front of the candidates.
    """
    T, part, row, first, count, centre, half, corners = casters
    least = own_distance / np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    for i in range(candidate_count):
        c = candidates[i]
        if part[c] == skip:
            continue
        begin = least if part[c] == own else 0.0
        r = row[c]
        x, y, z = p[0] - T[r, 0, 3], p[1] - T[r, 1, 3], p[2] - T[r, 2, 3]
        ox = T[r, 0, 0] * x + T[r, 1, 0] * y + T[r, 2, 0] * z
        oy = T[r, 0, 1] * x + T[r, 1, 1] * y + T[r, 2, 1] * z
        oz = T[r, 0, 2] * x + T[r, 1, 2] * y + T[r, 2, 2] * z
        sx = T[r, 0, 0] * d[0] + T[r, 1, 0] * d[1] + T[r, 2, 0] * d[2]
        sy = T[r, 0, 1] * d[0] + T[r, 1, 1] * d[1] + T[r, 2, 1] * d[2]
        sz = T[r, 0, 2] * d[0] + T[r, 1, 2] * d[1] + T[r, 2, 2] * d[2]
        low, high = 0.0, far
        u, v, w = 1.0 / (sx + 1e-300), 1.0 / (sy + 1e-300), 1.0 / (sz + 1e-300)
        a, b = (centre[c, 0] - half[c, 0] - ox) * u, (centre[c, 0] + half[c, 0] - ox) * u
        low, high = max(low, min(a, b)), min(high, max(a, b))
        a, b = (centre[c, 1] - half[c, 1] - oy) * v, (centre[c, 1] + half[c, 1] - oy) * v
        low, high = max(low, min(a, b)), min(high, max(a, b))
        a, b = (centre[c, 2] - half[c, 2] - oz) * w, (centre[c, 2] + half[c, 2] - oz) * w
        low, high = max(low, min(a, b)), min(high, max(a, b))
        if low > high * (1.0 + 1e-9) + 1e-12:
            continue
        for t in range(first[c], first[c] + count[c]):
            ax, ay, az = corners[t, 0, 0], corners[t, 0, 1], corners[t, 0, 2]
            e1x, e1y, e1z = corners[t, 1, 0] - ax, corners[t, 1, 1] - ay, corners[t, 1, 2] - az
            e2x, e2y, e2z = corners[t, 2, 0] - ax, corners[t, 2, 1] - ay, corners[t, 2, 2] - az
            px, py, pz = sy * e2z - sz * e2y, sz * e2x - sx * e2z, sx * e2y - sy * e2x
            det = e1x * px + e1y * py + e1z * pz
            if det == 0.0:
                continue
            scale = 1.0 / det
            tx, ty, tz = ox - ax, oy - ay, oz - az
            u = (tx * px + ty * py + tz * pz) * scale
            if u < 0.0 or u > 1.0:
                continue
            qx, qy, qz = ty * e1z - tz * e1y, tz * e1x - tx * e1z, tx * e1y - ty * e1x
            v = (sx * qx + sy * qy + sz * qz) * scale
            if v < 0.0 or u + v > 1.0:
                continue
            at = (e2x * qx + e2y * qy + e2z * qz) * scale
            if begin < at < far:
                candidates[i] = candidates[0]
                candidates[0] = c
                return True
    return False


@jit_inline
def find_surface_point(matrices, c, side, m, x, y, p, g):
    """Find the point where the ray of a pixel meets the plane of triangle m.

    The position x, y, px, is relative to the first pixel of cell c, whose pinhole model is
    matrices[c]. The point, shifted off the plane towards the camera, is written to p (3,), and the
    unit normal of the plane to g (3,). Return whether the ray meets the plane.
    """
    rx = matrices[c, 0, 0] * x + matrices[c, 0, 1] * y + matrices[c, 0, 2]
    ry = matrices[c, 1, 0] * x + matrices[c, 1, 1] * y + matrices[c, 1, 2]
    rz = matrices[c, 2, 0] * x + matrices[c, 2, 1] * y + matrices[c, 2, 2]
    gx = side[m, 0, 0] + side[m, 1, 0] + side[m, 2, 0]
    gy = side[m, 0, 1] + side[m, 1, 1] + side[m, 2, 1]
    gz = side[m, 0, 2] + side[m, 1, 2] + side[m, 2, 2]
    w = gx * rx + gy * ry + gz * rz
    is_hit = w > 1e-9
    size = 1.0 / np.sqrt(gx * gx + gy * gy + gz * gz)
    g[0], g[1], g[2] = -gx * size, -gy * size, -gz * size
    w = 1.0 / w if is_hit else 0.0
    p[0], p[1], p[2] = rx * w, ry * w, rz * w
    off = OFF + OFF_FAR * (abs(p[0]) + abs(p[1]) + abs(p[2]))
    p[0], p[1], p[2] = p[0] + off * g[0], p[1] + off * g[1], p[2] + off * g[2]
    return is_hit


@jit_inline
def _aim_ray(lamps, n, p, d, far, e, a, b, ray):
    """Write to ray (3,) the vector from p to a point of the disc that represents lamp n.

    The point has the coordinates a, b along the rows of e, in units of the disc's radius. d is the
    normal of the disc. Return the length of the ray in units of this vector: 1, or inf for a
    directional lamp.
    """
    radius = lamps[n, RADIUS]
    directional = lamps[n, KIND] == 0.0
    for j in range(3):
        offset = radius * (a * e[0, j] + b * e[1, j])
        ray[j] = d[j] + offset if directional else far * d[j] + offset
    return np.inf if directional else 1.0


@jit_inline
def cast_ray(casters, candidates, candidate_count, skip, own, own_distance, lamps, lamp, a, b,
             matrices, cell, side, m, x, y, work):
    """Return whether a lamp lights a point of triangle m: LIT, DARK or MIXED.

    Args:
        casters, candidates, candidate_count, skip, own, own_distance: see _is_blocked.
        lamps, lamp, a, b: lamp, and the point of its disc to which the ray goes, see _aim_ray.
        matrices, cell, side, m, x, y: surface point, see find_surface_point.
        work: (6, 3) work space.
    """
    p, g, d, ray, e = work[0], work[1], work[2], work[3], work[4:]
    if not find_surface_point(matrices, cell, side, m, x, y, p, g):
        return MIXED
    far, _ = direction_to_lamp(lamps, lamp, p, d)
    if lamps[lamp, RADIUS] > 0.0:
        _make_basis(d, e)
    end = _aim_ray(lamps, lamp, p, d, far, e, a, b, ray)
    if _is_blocked(p, ray, end, skip, own, own_distance, candidates, candidate_count, casters):
        return DARK
    return LIT
