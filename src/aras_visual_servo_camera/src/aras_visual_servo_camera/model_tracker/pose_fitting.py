"""Gauss-Newton estimation of a solid's pose from measured edges and depth images.

A point P of the solid is at p = R P + t in the camera's frame. The unknowns are the changes v and w
of the pose, which move the point by

    dp = v + w x (p - o) / u.

o is a point in the camera's frame. w is an angle multiplied by the length u, so the unit of v and w
is m. The residual is

    d - g . (p_xy / p_z - q)   for a point P on an edge,
    n . (X - p)                for a point X of the depth image.

An edge is expected at the image point q (normalised), and measured at the distance d in px along
its normal. g is the change of d in px per unit of normalised coordinates. X is on a face of the
solid with the unit normal n; p is a vertex of this face. The residuals are weighted by Tukey's
function, which is zero for outliers. Its scale is the standard deviation of the residuals, which is
estimated from the median of their absolute values.

References: T. Drummond and R. Cipolla, Real-time visual tracking of complex structures, IEEE PAMI
24(7), 2002; A. I. Comport, E. Marchand, M. Pressigout and F. Chaumette, Real-time markerless
tracking for augmented reality: the virtual visual servoing framework, IEEE TVCG 12(4), 2006; P. J.
Huber, Robust Statistics, Wiley, 1981.
"""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import jit, jit_inline

from .solid import transform_point

MAX_ITERATIONS = 6  # largest number of Gauss-Newton steps
CONVERGED_CHANGE = 0.01  # px; the iteration stops if a step moves the edges by less than this
# After each step, the lower limit of the scale of Tukey's function is multiplied by this factor,
# until it reaches the limit of the last step.
SCALE_REDUCTION = 0.3
# Largest step, in radii of the solid, of a motion that the edges do not determine; damping limits
# the step to about this length. The edges do not determine a motion if its standard deviation is
# larger than this length.
MAX_FREE_STEP = 0.1
# Lower limit of the estimated standard deviation of depth points from the solid's faces, in radii
# of the solid (0.3 mm for a radius of 5 cm).
FLATNESS = 6e-3
TUKEY_CONSTANT = 4.685  # the weight of a residual is zero beyond this many standard deviations
INLIER_DISTANCE = 1.0  # px; a measured edge is an inlier if the solid's edge is nearer than this
# Assumed variance, m^2, of the pose along a motion that the edges do not determine.
UNOBSERVABLE_VARIANCE = 1e4
# Ratio of the standard deviation to the median absolute deviation, for a normal distribution.
MAD_FACTOR = 1.4826


@jit("f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[::1], f8[:,::1], f8[::1], f8, f8")
def build_edge_equations(
    solid_points, image_points, gain, edge_offsets, weight, T, origin, unit, min_scale
):
    """Build the normal equations A (v, w) = b of edge points for a change (v, w) of the pose T.

    This module's docstring defines the symbols. v and w are in the camera's axes.

    Args:
        solid_points: (n, 3) points on the solid's edges, in its frame, m.
        image_points: (n, 2) image points q at which the edge points are expected, normalised.
        gain: (n, 2) g, the change of an edge's distance, px, per unit of normalised x and y.
        edge_offsets: (n, c) distances d of the candidate edges, px; NaN if there are fewer. The
            candidate nearest to the projected point is used.
        weight: (n,) weight of each point.
        T: (4, 4) camera_T_solid.
        origin: (3,) o, the centre of the rotation w in the camera's frame, m.
        unit: u, the length by which angles are multiplied, m.
        min_scale: lower limit of the scale of Tukey's function, px.

    Returns:
        A (6, 6); b (6,); the residuals (n,), NaN for a point without a candidate edge.
    """
    count = len(solid_points)
    rows, residuals = np.empty((count, 6)), np.full(count, np.nan)
    sizes, count_used = np.empty(count), 0
    for n in range(count):
        x, y, z = transform_point(T, solid_points[n])
        if z <= 0.0:
            continue
        dx, dy = x / z - image_points[n, 0], y / z - image_points[n, 1]
        projected_offset = gain[n, 0] * dx + gain[n, 1] * dy
        smallest = np.nan
        for c in range(edge_offsets.shape[1]):
            residual = edge_offsets[n, c] - projected_offset
            if residual == residual and not abs(residual) >= abs(smallest):
                smallest = residual
        if smallest != smallest:
            continue
        residuals[n] = smallest
        sizes[count_used] = abs(smallest)
        count_used += 1
        a, b = gain[n, 0] / z, gain[n, 1] / z
        c = -(a * x + b * y) / z
        rows[n, 0], rows[n, 1], rows[n, 2] = a, b, c
        x, y, z = (x - origin[0]) / unit, (y - origin[1]) / unit, (z - origin[2]) / unit
        rows[n, 3], rows[n, 4], rows[n, 5] = y * c - z * b, z * a - x * c, x * b - y * a
    A, right = np.zeros((6, 6)), np.zeros(6)
    if count_used == 0:
        return A, right, residuals
    scale = max(MAD_FACTOR * np.median(sizes[:count_used]), min_scale)
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
    """Return whether the point (x, y, z) in the plane of the triangle a, b, c is inside it.

    n: normal of the triangle.
    """
    for p, q in ((a, b), (b, c), (c, a)):
        ex, ey, ez = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        fx, fy, fz = x - p[0], y - p[1], z - p[2]
        cx, cy, cz = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
        if n[0] * cx + n[1] * cy + n[2] * cz < 0.0:
            return False
    return True


@jit("f8[:,::1], i8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[::1], f8, f8")
def build_surface_equations(vertices, faces, normals, measured_points, T, origin, unit, min_scale):
    """Build the normal equations A (v, w) = b of the points of a depth image.

    A residual is the distance (m) of a point from the solid's face that the ray of its pixel hits.
    It is weighted by the inverse variance of the residuals, 1/m^2, times Tukey's function.

    Args:
        vertices, faces, normals: fields of Solid.
        measured_points: (n, 3) normalised x, y of pixels and their depth, m.
        T, origin, unit: as in `build_edge_equations`.
        min_scale: lower limit of the scale of Tukey's function, m.

    Returns:
        A (6, 6); b (6,); the number of points on the solid.
    """
    points, rotated_normals = np.empty((len(vertices), 3)), np.empty((len(faces), 3))
    for i in range(len(vertices)):
        for k in range(3):
            points[i, k] = T[k, 3]
            for m in range(3):
                points[i, k] += T[k, m] * vertices[i, m]
    for f in range(len(faces)):
        for k in range(3):
            rotated_normals[f, k] = 0.0
            for m in range(3):
                rotated_normals[f, k] += T[k, m] * normals[f, m]
    residuals, sizes = np.empty(len(measured_points)), np.empty(len(measured_points))
    face_indices, used = np.full(len(measured_points), -1), 0
    for i in range(len(measured_points)):
        x, y, d = measured_points[i]
        nearest = np.inf
        for f in range(len(faces)):
            a, b, c = points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]
            n = rotated_normals[f]
            facing = n[0] * a[0] + n[1] * a[1] + n[2] * a[2]
            along = n[0] * x + n[1] * y + n[2]
            if facing >= 0.0 or along >= 0.0 or facing / along >= nearest:
                continue
            z = facing / along
            if _is_inside_triangle(x * z, y * z, z, a, b, c, n):
                nearest, face_indices[i] = z, f
        if face_indices[i] >= 0:
            n, a = rotated_normals[face_indices[i]], points[faces[face_indices[i], 0]]
            residuals[i] = n[0] * (x * d - a[0]) + n[1] * (y * d - a[1]) + n[2] * (d - a[2])
            sizes[used] = abs(residuals[i])
            used += 1
    A, right = np.zeros((6, 6)), np.zeros(6)
    if used == 0:
        return A, right, 0
    scale = max(MAD_FACTOR * np.median(sizes[:used]), min_scale)
    row, count = np.empty(6), 0
    for i in range(len(measured_points)):
        if face_indices[i] < 0 or abs(residuals[i]) >= TUKEY_CONSTANT * scale:
            continue
        part = residuals[i] / (TUKEY_CONSTANT * scale)
        w = ((1.0 - part * part) / scale) ** 2
        x, y, d = measured_points[i]
        n = rotated_normals[face_indices[i]]
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
    """Change the normal equations A (v, w) = b so that the solution is orthogonal to `free_motion`.

    free_motion: (6,) unit vector (v, w) of a motion that leaves the solid's surface unchanged.
    """
    component = 0.0
    for i in range(6):
        component += free_motion[i] * b[i]
    for i in range(6):
        b[i] -= free_motion[i] * component
        projection = 0.0
        for j in range(6):
            projection += A[i, j] * free_motion[j]
        for j in range(6):
            A[i, j] -= projection * free_motion[j]
    for j in range(6):
        projection = 0.0
        for i in range(6):
            projection += free_motion[i] * A[i, j]
        for i in range(6):
            A[i, j] -= free_motion[i] * projection


@jit("f8[:,::1], f8[::1], f8[::1], f8[::1]")
def _update_pose(T, rotation, translation, middle):
    """Return a pose (4, 4) that differs from T by a rotation and has a new position.

    Args:
        T: (4, 4) camera_T_solid.
        rotation: (3,) rotation vector, rad, in the camera's axes.
        translation: (3,) new position of the solid's middle in the camera's frame, m.
        middle: (3,) middle of the solid in its own frame, m.
    """
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
             middle, radius, free_motions, vertices, faces, normals, surface):  # fmt: skip
    """Fit a pose to measured edges and to the points of a depth image.

    Args:
        solid_points, image_points, gain, edge_offsets, weight: as in `build_edge_equations`.
        T: (4, 4) initial camera_T_solid.
        first_scale, last_scale: lower limit of the scale of Tukey's function in the first and in
            the last step, px.
        middle: (3,) middle of the solid in its own frame, m. Rotations are about this point.
        radius: radius of the solid, m. Angles are multiplied by it, so that all unknowns are
            lengths.
        free_motions: (k, 6) motions that leave the solid's surface unchanged, one in each row. The
            pose is not changed along these motions.
        vertices, faces, normals: fields of Solid.
        surface: (m, 3) points of a depth image, as `measured_points` of `build_surface_equations`.

    Returns:
        The fitted pose (4, 4); the approximate change from the initial pose in the image, px; the
        residuals (n,) of the edges; and the matrix A (6, 6) of the normal equations A (v, w) = b.
    """
    focal = np.hypot(gain[0, 0], gain[0, 1]) if len(gain) else 0.0
    origin, first_origin, free_motion = np.empty(3), np.empty(3), np.empty(6)
    pose, min_scale, total_rotation = T.copy(), first_scale, np.zeros(3)
    residuals, A = np.full(len(edge_offsets), np.nan), np.zeros((6, 6))
    for step in range(MAX_ITERATIONS + 1):
        for k in range(3):
            origin[k] = pose[k, 3]
            for m in range(3):
                origin[k] += pose[k, m] * middle[m]
        if step == 0:
            for k in range(3):
                first_origin[k] = origin[k]
        A, b, residuals = build_edge_equations(
            solid_points, image_points, gain, edge_offsets, weight, pose, origin, radius, min_scale
        )
        if len(surface):
            surface_A, surface_b, _ = build_surface_equations(
                vertices, faces, normals, surface, pose, origin, radius, FLATNESS * radius)
            for i in range(6):
                b[i] += surface_b[i]
                for j in range(6):
                    A[i, j] += surface_A[i, j]
        for s in range(len(free_motions)):
            for k in range(3):
                free_motion[k] = free_motion[3 + k] = 0.0
                for m in range(3):
                    free_motion[k] += pose[k, m] * free_motions[s, m]
                    free_motion[3 + k] += pose[k, m] * free_motions[s, 3 + m]
            _remove_motion(A, b, free_motion)
        if step == MAX_ITERATIONS:
            break
        damped = A.copy()
        for i in range(6):
            damped[i, i] += 1.0 / (MAX_FREE_STEP * radius) ** 2
        change = np.linalg.solve(damped, b)
        rotation, new_origin = np.empty(3), np.empty(3)
        squared_translation = squared_rotation = 0.0
        for k in range(3):
            total_rotation[k] += change[3 + k]
            rotation[k], new_origin[k] = change[3 + k] / radius, origin[k] + change[k]
            squared_translation += change[k] ** 2
            squared_rotation += change[3 + k] ** 2
        pose = _update_pose(pose, rotation, new_origin, middle)
        change_norm = np.sqrt(squared_translation) + np.sqrt(squared_rotation)
        if min_scale == last_scale and focal * change_norm < CONVERGED_CHANGE * origin[2]:
            break
        min_scale = max(SCALE_REDUCTION * min_scale, last_scale)
    squared_translation = squared_rotation = 0.0
    for k in range(3):
        squared_translation += (origin[k] - first_origin[k]) ** 2
        squared_rotation += total_rotation[k] ** 2
    total = np.sqrt(squared_translation) + np.sqrt(squared_rotation)
    return pose, focal * total / origin[2], residuals, A


@jit("f8[::1], f8[::1], f8[:,::1], i8, f8")
def assess_pose(residuals, weight, A, free_motion_count, radius):
    """Assess the accuracy of a fitted pose.

    Args:
        residuals: (n,) residuals of the edges, as returned by `fit_pose`, px.
        weight: (n,) inverse variance of each residual, 1/px^2.
        A: (6, 6) matrix of the normal equations, as returned by `fit_pose`.
        free_motion_count: number of motions that leave the solid's surface unchanged.
        radius: radius of the solid, m.

    Returns:
        The number of inliers, whose residuals are below INLIER_DISTANCE;
        the rms of the inliers' residuals, px;
        the ratio of the measured to the expected variance of these residuals, at least 1;
        the covariance (6, 6) of the pose's error (m, rad) about the solid's middle;
        whether there is a motion that changes the position of the solid's surface, but that the
        edges do not determine.
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
        variance = UNOBSERVABLE_VARIANCE
        if values[k] > 0.0:
            variance = min(excess / values[k], UNOBSERVABLE_VARIANCE)
        for i in range(6):
            for j in range(6):
                covariance[i, j] += variance * vectors[i, k] * vectors[j, k]
    for i in range(6):
        for j in range(6):
            covariance[i, j] /= (radius if i > 2 else 1.0) * (radius if j > 2 else 1.0)
    least = excess / (MAX_FREE_STEP * radius) ** 2
    is_open = free_motion_count < 6 and not values[min(free_motion_count, 5)] > least
    return count, rms, excess, covariance, is_open
