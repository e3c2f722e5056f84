"""Gauss-Newton on a pose, by how far edges and surfaces are from where it has them.

    p = R P + t,  dp = v + w x p,   residual of an edge: d - g . (p_xy / p_z - seen),
                                    residual of a surface: n . (X - p),

with d px along its normal as measured from `seen`, and g px for normalised coordinates; X is a
point of the depth image, p and n the point and the normal of the face that it should lie in.
Residuals are weighted by Tukey's function, so what lies far beyond the usual has no weight.

References: T. Drummond and R. Cipolla, Real-time visual tracking of complex structures, IEEE PAMI
24(7), 2002; A. I. Comport, E. Marchand, M. Pressigout and F. Chaumette, Real-time markerless
tracking for augmented reality: the virtual visual servoing framework, IEEE TVCG 12(4), 2006; P. J.
Huber, Robust Statistics, Wiley, 1981.
"""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import compiled, inlined

TUKEY = 4.685  # times the standard deviation, beyond which a residual has no weight
NORMAL = 1.4826  # standard deviation over median of absolute values


@compiled("f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[::1], f8[:,::1], f8")
def edge_equations(at, seen, gain, away, weight, T, least):
    """Normal equations of edge points for a change (v, w) of the pose T, in the camera's axes.

    Args:
        at, seen, gain: as of EdgePoints. away: (n, c) px along the normal of each candidate, NaN
            where there is none; the nearest counts. weight: (n,). least: px, of the scale.

    Answers:
        A (6, 6) and b (6,); residuals (n,), NaN where there are none.
    """
    count = len(at)
    rows, residuals = np.empty((count, 6)), np.full(count, np.nan)
    sizes, used = np.empty(count), 0
    for n in range(count):
        x = T[0, 0] * at[n, 0] + T[0, 1] * at[n, 1] + T[0, 2] * at[n, 2] + T[0, 3]
        y = T[1, 0] * at[n, 0] + T[1, 1] * at[n, 1] + T[1, 2] * at[n, 2] + T[1, 3]
        z = T[2, 0] * at[n, 0] + T[2, 1] * at[n, 1] + T[2, 2] * at[n, 2] + T[2, 3]
        if z <= 0.0:
            continue
        now = gain[n, 0] * (x / z - seen[n, 0]) + gain[n, 1] * (y / z - seen[n, 1])
        best = np.nan
        for c in range(away.shape[1]):
            one = away[n, c] - now
            if one == one and not abs(one) >= abs(best):
                best = one
        if best != best:
            continue
        residuals[n] = best
        sizes[used] = abs(best)
        used += 1
        a, b = gain[n, 0] / z, gain[n, 1] / z
        c = -(a * x + b * y) / z
        rows[n, 0], rows[n, 1], rows[n, 2] = a, b, c
        rows[n, 3], rows[n, 4], rows[n, 5] = y * c - z * b, z * a - x * c, x * b - y * a
    A, right = np.zeros((6, 6)), np.zeros(6)
    if used == 0:
        return A, right, residuals
    scale = max(NORMAL * np.median(sizes[:used]), least)
    for n in range(count):
        if residuals[n] != residuals[n]:
            continue
        part = residuals[n] / (TUKEY * scale)
        if abs(part) >= 1.0:
            continue
        w = weight[n] * (1.0 - part * part) ** 2
        for i in range(6):
            right[i] += w * rows[n, i] * residuals[n]
            for j in range(i + 1):
                A[i, j] += w * rows[n, i] * rows[n, j]
    for i in range(6):
        for j in range(i):
            A[j, i] = A[i, j]
    return A, right, residuals


@inlined
def _around(x, y, z, a, b, c, n):
    """Whether a point of the triangle's plane is inside of it."""
    for p, q in ((a, b), (b, c), (c, a)):
        ex, ey, ez = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        fx, fy, fz = x - p[0], y - p[1], z - p[2]
        side = (n[0] * (ey * fz - ez * fy) + n[1] * (ez * fx - ex * fz)
                + n[2] * (ex * fy - ey * fx))  # fmt: skip
        if side < 0.0:
            return False
    return True


@compiled("f8[:,::1], i8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8")
def surface_equations(vertices, faces, normals, measured, T, least):
    """Normal equations of a depth image, for a change as of `edge_equations`; weighted by 1/m^2.

    Args:
        vertices, faces, normals: of the solid. measured: (n, 3) normalised x, y of pixels, and
            their depth, m. least: m, of the scale.

    Answers A (6, 6), b (6,), and how many points lie on the solid.
    """
    points, turned = np.empty((len(vertices), 3)), np.empty((len(faces), 3))
    for i in range(len(vertices)):
        for k in range(3):
            points[i, k] = T[k, 3]
            for m in range(3):
                points[i, k] += T[k, m] * vertices[i, m]
    for f in range(len(faces)):
        for k in range(3):
            turned[f, k] = 0.0
            for m in range(3):
                turned[f, k] += T[k, m] * normals[f, m]
    residuals, sizes = np.empty(len(measured)), np.empty(len(measured))
    on, used = np.full(len(measured), -1), 0
    for i in range(len(measured)):
        x, y, d = measured[i]
        nearest = np.inf
        for f in range(len(faces)):
            a, b, c = points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]
            n = turned[f]
            facing = n[0] * a[0] + n[1] * a[1] + n[2] * a[2]
            along = n[0] * x + n[1] * y + n[2]
            if facing >= 0.0 or along >= 0.0 or facing / along >= nearest:
                continue
            z = facing / along
            if _around(x * z, y * z, z, a, b, c, n):
                nearest, on[i] = z, f
        if on[i] >= 0:
            n, a = turned[on[i]], points[faces[on[i], 0]]
            residuals[i] = n[0] * (x * d - a[0]) + n[1] * (y * d - a[1]) + n[2] * (d - a[2])
            sizes[used] = abs(residuals[i])
            used += 1
    A, right = np.zeros((6, 6)), np.zeros(6)
    if used == 0:
        return A, right, 0
    scale = max(NORMAL * np.median(sizes[:used]), least)
    row, count = np.empty(6), 0
    for i in range(len(measured)):
        if on[i] < 0 or abs(residuals[i]) >= TUKEY * scale:
            continue
        part = residuals[i] / (TUKEY * scale)
        w = ((1.0 - part * part) / scale) ** 2
        x, y, d = measured[i]
        n = turned[on[i]]
        row[:3] = n
        row[3] = y * d * n[2] - d * n[1]
        row[4] = d * n[0] - x * d * n[2]
        row[5] = x * d * n[1] - y * d * n[0]
        count += 1
        for j in range(6):
            right[j] += w * row[j] * residuals[i]
            for k in range(6):
                A[j, k] += w * row[j] * row[k]
    return A, right, count
