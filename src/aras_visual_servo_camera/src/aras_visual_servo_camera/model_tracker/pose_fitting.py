"""Gauss-Newton on a pose, by how far edges and surfaces are from where it has them.

    p = R P + t,  dp = v + w x (p - o) / u,   residual of an edge: d - g . (p_xy / p_z - seen),
                                              residual of a surface: n . (X - p),

about a point o of the camera's frame; w is m too, radians times a length u. d is px along the
edge's normal as measured from `image_points`, and g px for normalised coordinates; X is a point of
the depth image, p and n the point and the normal of the face that it should lie in. Residuals
are
weighted by Tukey's function, so what lies far beyond the usual has no weight.

References: T. Drummond and R. Cipolla, Real-time visual tracking of complex structures, IEEE PAMI
24(7), 2002; A. I. Comport, E. Marchand, M. Pressigout and F. Chaumette, Real-time markerless
tracking for augmented reality: the virtual visual servoing framework, IEEE TVCG 12(4), 2006; P. J.
Huber, Robust Statistics, Wiley, 1981.
"""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import jit, jit_inline

MAX_ITERATIONS = 6  # Gauss-Newton steps, at most
CONVERGED_CHANGE = 0.01  # px: a change of the pose by less is none
SCALE_REDUCTION = 0.3  # part of the last step's least scale
# Parts of the solid's radius: that a motion goes at once of which the edges tell nothing, and to
# which the points of a depth image are exact at best; 5 and 0.3 mm of one of 5 cm.
MAX_FREE_STEP, FLATNESS = 0.1, 6e-3
TUKEY_CONSTANT = 4.685  # times the standard deviation, beyond which a residual has no weight
INLIER_DISTANCE = 1.0  # px from the solid within which an edge counts as its own
UNOBSERVABLE_VARIANCE = 1e4  # m^2, variance of what the edges cannot tell
MAD_FACTOR = 1.4826  # standard deviation over median of absolute values


@jit("f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[::1], f8[:,::1], f8[::1], f8, f8")
def build_edge_equations(
    solid_points, image_points, gain, edge_offsets, weight, T, origin, unit, min_scale
):
    """Normal equations of edge points for a change (v, w) of the pose T, in the camera's axes.

    Args:
        at, seen, gain: as of EdgePoints. away: (n, c) px along the normal of each candidate, NaN
            where there is none; the nearest counts. weight: (n,). about, unit: o (3,) and u.
            least: px, of the scale.

    Answers:
        A (6, 6) and b (6,); residuals (n,), NaN where there are none.
    """
    count = len(solid_points)
    rows, residuals = np.empty((count, 6)), np.full(count, np.nan)
    sizes, used = np.empty(count), 0
    for n in range(count):
        x = (
            T[0, 0] * solid_points[n, 0]
            + T[0, 1] * solid_points[n, 1]
            + T[0, 2] * solid_points[n, 2]
            + T[0, 3]
        )
        y = (
            T[1, 0] * solid_points[n, 0]
            + T[1, 1] * solid_points[n, 1]
            + T[1, 2] * solid_points[n, 2]
            + T[1, 3]
        )
        z = (
            T[2, 0] * solid_points[n, 0]
            + T[2, 1] * solid_points[n, 1]
            + T[2, 2] * solid_points[n, 2]
            + T[2, 3]
        )
        if z <= 0.0:
            continue
        now = gain[n, 0] * (x / z - image_points[n, 0]) + gain[n, 1] * (y / z - image_points[n, 1])
        best = np.nan
        for c in range(edge_offsets.shape[1]):
            one = edge_offsets[n, c] - now
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
        x, y, z = (x - origin[0]) / unit, (y - origin[1]) / unit, (z - origin[2]) / unit
        rows[n, 3], rows[n, 4], rows[n, 5] = y * c - z * b, z * a - x * c, x * b - y * a
    A, right = np.zeros((6, 6)), np.zeros(6)
    if used == 0:
        return A, right, residuals
    scale = max(MAD_FACTOR * np.median(sizes[:used]), min_scale)
    for n in range(count):
        if residuals[n] != residuals[n]:
            continue
        part = residuals[n] / (TUKEY_CONSTANT * scale)
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


@jit_inline
def _is_inside_triangle(x, y, z, a, b, c, n):
    """Whether a point of the triangle's plane is inside of it."""
    for p, q in ((a, b), (b, c), (c, a)):
        ex, ey, ez = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        fx, fy, fz = x - p[0], y - p[1], z - p[2]
        side = (n[0] * (ey * fz - ez * fy) + n[1] * (ez * fx - ex * fz)
                + n[2] * (ex * fy - ey * fx))  # fmt: skip
        if side < 0.0:
            return False
    return True


@jit("f8[:,::1], i8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[::1], f8, f8")
def build_surface_equations(vertices, faces, normals, measured_points, T, origin, unit, min_scale):
    """Normal equations of a depth image, for a change as of `build_edge_equations`; weighted by
    1/m^2.

    Args:
        vertices, faces, normals: of the solid. measured: (n, 3) normalised x, y of pixels, and
            their depth, m. about, unit, least: as there, but least in m.

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
    residuals, sizes = np.empty(len(measured_points)), np.empty(len(measured_points))
    on, used = np.full(len(measured_points), -1), 0
    for i in range(len(measured_points)):
        x, y, d = measured_points[i]
        nearest = np.inf
        for f in range(len(faces)):
            a, b, c = points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]
            n = turned[f]
            facing = n[0] * a[0] + n[1] * a[1] + n[2] * a[2]
            along = n[0] * x + n[1] * y + n[2]
            if facing >= 0.0 or along >= 0.0 or facing / along >= nearest:
                continue
            z = facing / along
            if _is_inside_triangle(x * z, y * z, z, a, b, c, n):
                nearest, on[i] = z, f
        if on[i] >= 0:
            n, a = turned[on[i]], points[faces[on[i], 0]]
            residuals[i] = n[0] * (x * d - a[0]) + n[1] * (y * d - a[1]) + n[2] * (d - a[2])
            sizes[used] = abs(residuals[i])
            used += 1
    A, right = np.zeros((6, 6)), np.zeros(6)
    if used == 0:
        return A, right, 0
    scale = max(MAD_FACTOR * np.median(sizes[:used]), min_scale)
    row, count = np.empty(6), 0
    for i in range(len(measured_points)):
        if on[i] < 0 or abs(residuals[i]) >= TUKEY_CONSTANT * scale:
            continue
        part = residuals[i] / (TUKEY_CONSTANT * scale)
        w = ((1.0 - part * part) / scale) ** 2
        x, y, d = measured_points[i]
        n = turned[on[i]]
        row[0], row[1], row[2] = n[0], n[1], n[2]
        x, y, z = (x * d - origin[0]) / unit, (y * d - origin[1]) / unit, (d - origin[2]) / unit
        row[3], row[4], row[5] = y * n[2] - z * n[1], z * n[0] - x * n[2], x * n[1] - y * n[0]
        count += 1
        for j in range(6):
            right[j] += w * row[j] * residuals[i]
            for k in range(6):
                A[j, k] += w * row[j] * row[k]
    return A, right, count


@jit("f8[:,::1], f8[::1], f8[::1]", allocates=False)
def _remove_motion(A, b, free_motion):
    """Takes a motion (6,) of length 1 out of normal equations."""
    told = 0.0
    for i in range(6):
        told += free_motion[i] * b[i]
    for i in range(6):
        b[i] -= free_motion[i] * told
        along = 0.0
        for j in range(6):
            along += A[i, j] * free_motion[j]
        for j in range(6):
            A[i, j] -= along * free_motion[j]
    for j in range(6):
        along = 0.0
        for i in range(6):
            along += free_motion[i] * A[i, j]
        for i in range(6):
            A[i, j] -= free_motion[i] * along


@jit("f8[:,::1], f8[::1], f8[::1], f8[::1]")
def _update_pose(T, rotation, translation, middle):
    """The pose T (4, 4) turned by a rotation vector (3,), with the solid's middle (3,) at place."""
    angle = np.sqrt(rotation[0] ** 2 + rotation[1] ** 2 + rotation[2] ** 2)
    first, second = 1.0, 0.5
    if angle > 1e-8:
        first, second = np.sin(angle) / angle, 2.0 * (np.sin(0.5 * angle) / angle) ** 2
    found = np.zeros((4, 4))
    found[3, 3] = 1.0
    x, y, z = rotation
    for k in range(3):
        a, b, c = T[0, k], T[1, k], T[2, k]
        u, v, w = y * c - z * b, z * a - x * c, x * b - y * a
        found[0, k] = a + first * u + second * (y * w - z * v)
        found[1, k] = b + first * v + second * (z * u - x * w)
        found[2, k] = c + first * w + second * (x * v - y * u)
    for k in range(3):
        found[k, 3] = translation[k]
        for m in range(3):
            found[k, 3] -= found[k, m] * middle[m]
    return found


@jit("f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[::1], f8[:,::1], f8, f8, f8[::1], f8, "
          "f8[:,::1], f8[:,::1], i8[:,::1], f8[:,::1], f8[:,::1]")  # fmt: skip
def fit_pose(solid_points, image_points, gain, edge_offsets, weight, T, first_scale, last_scale,
    middle, radius, free_motions, vertices, faces,
           normals, surface):  # fmt: skip
    """The pose that edges, and points of a depth image, are explained by.

    Args:
        at, seen, gain, away, weight: as of `build_edge_equations`. T: (4, 4) to begin with.
        wide, exact: px, least scales of the residuals in the first and in the last steps.
        middle, radius: (3,) m, in the solid's frame, and m: o and u.
        slips: (k, 6) as of Solid.slips, the rows: left out.
        vertices, faces, normals: of the solid. surface: (n, 3) `measured_points` of
        `build_surface_equations`.

    Answers:
        the pose; how far it moved the solid in the picture, px, about; the residuals (n,) and the
        information A (6, 6) about the middle, in the camera's axes.
    """
    focal = np.hypot(gain[0, 0], gain[0, 1]) if len(gain) else 0.0
    about, first, slip = np.empty(3), np.empty(3), np.empty(6)
    pose, least, turned = T.copy(), first_scale, np.zeros(3)
    residuals, A = np.full(len(edge_offsets), np.nan), np.zeros((6, 6))
    for step in range(MAX_ITERATIONS + 1):
        for k in range(3):
            about[k] = pose[k, 3]
            for m in range(3):
                about[k] += pose[k, m] * middle[m]
        if step == 0:
            for k in range(3):
                first[k] = about[k]
        A, b, residuals = build_edge_equations(
            solid_points, image_points, gain, edge_offsets, weight, pose, about, radius, least
        )
        if len(surface):
            more, told, _ = build_surface_equations(
                vertices, faces, normals, surface, pose, about, radius, FLATNESS * radius)
            for i in range(6):
                b[i] += told[i]
                for j in range(6):
                    A[i, j] += more[i, j]
        for s in range(len(free_motions)):
            for k in range(3):
                slip[k] = slip[3 + k] = 0.0
                for m in range(3):
                    slip[k] += pose[k, m] * free_motions[s, m]
                    slip[3 + k] += pose[k, m] * free_motions[s, 3 + m]
            _remove_motion(A, b, slip)
        if step == MAX_ITERATIONS:
            break
        damped = A.copy()
        for i in range(6):
            damped[i, i] += 1.0 / (MAX_FREE_STEP * radius) ** 2
        change = np.linalg.solve(damped, b)
        turn, place, along, around = np.empty(3), np.empty(3), 0.0, 0.0
        for k in range(3):
            turned[k] += change[3 + k]
            turn[k], place[k] = change[3 + k] / radius, about[k] + change[k]
            along += change[k] ** 2
            around += change[3 + k] ** 2
        pose = _update_pose(pose, turn, place, middle)
        moved = np.sqrt(along) + np.sqrt(around)
        if least == last_scale and focal * moved < CONVERGED_CHANGE * about[2]:
            break
        least = max(SCALE_REDUCTION * least, last_scale)
    along = around = 0.0
    for k in range(3):
        along += (about[k] - first[k]) ** 2
        around += turned[k] ** 2
    total = np.sqrt(along) + np.sqrt(around)
    return pose, focal * total / about[2], residuals, A


@jit("f8[::1], f8[::1], f8[:,::1], i8, f8")
def assess_pose(residuals, weight, A, free_motion_count, radius):
    """How well a pose is known.

    Args:
        residuals, A: as `fit_pose` answers them. weight: (n,) 1 / px^2. slips: number of motions
            that no picture tells. radius: m.

    Answers:
        how many points are explained; their distances, px, rms; how many times as large, squared,
        these are as the weights let expect, at least 1; the covariance (6, 6) of a change (m, rad)
        about the middle; whether a motion is open that a picture can tell.
    """
    count, squares, weighted = 0, 0.0, 0.0
    for n in range(len(residuals)):
        if abs(residuals[n]) < INLIER_DISTANCE:
            count += 1
            squares += residuals[n] ** 2
            weighted += weight[n] * residuals[n] ** 2
    rms = np.sqrt(squares / count) if count else np.inf
    excess = max(weighted / max(count - 6, 1), 1.0)
    values, vectors = np.linalg.eigh(A)
    covariance = np.zeros((6, 6))
    for k in range(6):
        variance = (
            min(excess / values[k], UNOBSERVABLE_VARIANCE)
            if values[k] > 0.0
            else UNOBSERVABLE_VARIANCE
        )
        for i in range(6):
            for j in range(6):
                covariance[i, j] += variance * vectors[i, k] * vectors[j, k]
    for i in range(6):
        for j in range(6):
            covariance[i, j] /= (radius if i > 2 else 1.0) * (radius if j > 2 else 1.0)
    is_open = (
        free_motion_count < 6
        and not values[min(free_motion_count, 5)] > excess / (MAX_FREE_STEP * radius) ** 2
    )
    return count, rms, excess, covariance, is_open
