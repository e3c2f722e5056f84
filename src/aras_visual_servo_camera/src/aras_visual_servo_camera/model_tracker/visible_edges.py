"""Selection of points on those edges of a solid that are visible to the camera."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from aras_visual_servo_base.compiled import jit

from ..camera_model import CameraModel
from .solid import Solid, transform_point

MIN_DEPTH = 0.01  # m, depth along the optical axis; nearer edges are ignored
MAX_POINTS = 1200  # largest number of sample points on edges per image
# On an edge longer than SHORT_EDGE, px, no points are sampled within END_MARGIN, px, of the edge's
# ends.
END_MARGIN, SHORT_EDGE = 4.0, 16.0
BORDER = 5.0  # px; no points are sampled within this distance from the border of the image
# If the cosine of the angle between a face's normal and the ray to the camera is in this range, the
# face is viewed edge-on. Its creases are not used: they nearly coincide in the image, and a small
# error of the pose makes the face visible or invisible.
GRAZING_COSINES = (-0.01, 0.03)
# A face hides a point if the face is nearer to the camera by at least this fraction of the depth.
OCCLUSION_TOLERANCE = 2e-3
NO_EDGE_DISTANCE = 1e6  # px; stands for the distance to the next edge if there is none
BAND = 16  # px; edges are sorted into bands of this many rows, and into bands of this many columns
STEP = 1e-4  # step of the numerical derivatives of the lens model, in normalised coordinates


class EdgePoints(NamedTuple):
    """n sample points on the edges of a solid that are visible from one pose of the camera.

    Attributes:
        solid_points: (n, 3) points in the solid's frame, m.
        image_points: (n, 2) points in the image, normalised.
        pixels: (n, 2) points in the image, px (column, row).
        normals: (n, 2) unit normal of the edge in the image, px, towards its first face.
        gains: (n, 2) displacement along `normals`, px, if normalised x or y changes by 1.
        room: (n, 2) distances, px, from the point to the nearest other edges on its two sides,
            along the row or column on which the edge is searched.
        edges: (n,) index of the edge.
        are_faces_visible: (n, 2) whether the first and the second face of the edge are visible.
    """

    solid_points: np.ndarray
    image_points: np.ndarray
    pixels: np.ndarray
    normals: np.ndarray
    gains: np.ndarray
    room: np.ndarray
    edges: np.ndarray
    are_faces_visible: np.ndarray


def sample_visible_edges(
    solid: Solid, camera: CameraModel, camera_T_solid: np.ndarray, spacing: float
) -> EdgePoints:
    """Sample the visible edges of a solid every `spacing` px.

    camera_T_solid: (4, 4) pose of the solid in the camera's frame.
    """
    hole = camera.pinhole
    points = EdgePoints(*_sample_edges(
        solid.vertices, solid.faces, solid.normals, solid.edges, solid.edge_faces, solid.is_crease,
        solid.is_outermost,
        np.ascontiguousarray(camera_T_solid), np.array([hole.fx, hole.fy, hole.cx, hole.cy]),
        camera.width, camera.height, spacing,
    ))  # fmt: skip
    if not camera.is_distorted:
        return points
    focal = np.array([hole.fx, hole.fy])
    pixel, normal, gain = _distort_samples(camera, points.image_points, points.normals, focal)
    last = camera.width - BORDER, camera.height - BORDER
    inside = ((pixel > BORDER) & (pixel < last)).all(axis=1)
    bent = points._replace(pixels=pixel, normals=normal, gains=gain)
    return EdgePoints(*(np.ascontiguousarray(a[inside]) for a in bent))


def _distort_samples(
    camera: CameraModel, image_points: np.ndarray, normal: np.ndarray, focal: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the pixels, normals and gains of points in the image with lens distortion.

    Args:
        camera: intrinsics and distortion.
        image_points: (n, 2) points, normalised.
        normal: (n, 2) normals in the undistorted image, px.
        focal: (2,) focal lengths fx and fy, px.

    Returns:
        pixels (n, 2), normals (n, 2) and gains (n, 2), as in EdgePoints.
    """
    x, y = image_points.T
    u, v = camera.project(x, y)
    derivative = np.empty((len(x), 2, 2))  # derivatives of (u, v) by (x, y), px
    for k, (dx, dy) in enumerate(((STEP, 0.0), (0.0, STEP))):
        more, less = camera.project(x + dx, y + dy), camera.project(x - dx, y - dy)
        derivative[:, 0, k] = (more[0] - less[0]) / (2.0 * STEP)
        derivative[:, 1, k] = (more[1] - less[1]) / (2.0 * STEP)
    along = np.stack([-normal[:, 1], normal[:, 0]], axis=1) / focal
    along = (derivative @ along[:, :, None])[:, :, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    bent = np.stack([along[:, 1], -along[:, 0]], axis=1)
    return np.stack([u, v], axis=1), bent, (bent[:, None] @ derivative)[:, 0]


@jit("f8, f8, f8, f8[:,::1], i8[:,::1], i8[::1], i8, i8", allocates=False)
def _is_hidden(u, v, w, projected, faces, front_faces, face, other_face):
    """Return whether a face hides the point at the pixel (u, v) with the inverse depth w.

    Args:
        u, v: pixel of the point.
        w: inverse depth of the point, 1/m.
        projected: (V, 3) u, v and inverse depth of the vertices.
        faces: (F, 3) vertices of each face.
        front_faces: indices of the faces that face the camera.
        face, other_face: the two faces of the point's edge, which cannot hide it.
    """
    for f in front_faces:
        if f in (face, other_face):
            continue
        a, b, c = projected[faces[f, 0]], projected[faces[f, 1]], projected[faces[f, 2]]
        if a[2] == 0.0 or b[2] == 0.0 or c[2] == 0.0:
            continue
        if (u < a[0] and u < b[0] and u < c[0]) or (u > a[0] and u > b[0] and u > c[0]) or (
            v < a[1] and v < b[1] and v < c[1]) or (v > a[1] and v > b[1] and v > c[1]):
            continue
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area == 0.0:
            continue
        p = ((b[0] - u) * (c[1] - v) - (b[1] - v) * (c[0] - u)) / area
        q = ((c[0] - u) * (a[1] - v) - (c[1] - v) * (a[0] - u)) / area
        r = 1.0 - p - q
        inside = p >= 0.0 and q >= 0.0 and r >= 0.0
        if inside and p * a[2] + q * b[2] + r * c[2] > w * (1.0 + OCCLUSION_TOLERANCE):
            return True
    return False


@jit("f8[:,::1], i8[:,::1], i8[::1], i8, i8")
def _sort_into_bands(projected, edges, visible_edges, axis, size):
    """Sort the visible edges into bands of the image, which have BAND rows or columns each.

    Args:
        projected: (V, 3) u, v and inverse depth of the vertices.
        edges: (E, 2) vertices of each edge.
        visible_edges: indices of the visible edges.
        axis: 1 for bands of rows, 0 for bands of columns.
        size: number of rows or columns of the image.

    Returns:
        Two arrays, `first` and `members`. The indices of the edges that cross band i are
        members[first[i] : first[i + 1]].
    """
    count = size // BAND + 1
    first = np.zeros(count + 1, np.int64)
    reach = np.empty((len(visible_edges), 2), np.int64)
    for s in range(len(visible_edges)):
        i, j = edges[visible_edges[s]]
        a, b = projected[i, axis], projected[j, axis]
        reach[s, 0] = max(int(min(a, b) / BAND), 0)
        reach[s, 1] = min(int(max(a, b) / BAND), count - 1)
        for i in range(reach[s, 0], reach[s, 1] + 1):
            first[i + 1] += 1
    for i in range(count):
        first[i + 1] += first[i]
    next_index, members = first.copy(), np.empty(first[count], np.int64)
    for s in range(len(visible_edges)):
        for i in range(reach[s, 0], reach[s, 1] + 1):
            members[next_index[i]] = visible_edges[s]
            next_index[i] += 1
    return first, members


@jit("f8, f8, b1, i8, f8[:,::1], i8[:,::1], i8[::1]", allocates=False)
def _measure_room(u, v, across, edge, projected, edges, nearby_edges):
    """Measure the distances, px, from a point of an edge to the next other edges.

    Args:
        u, v: pixel of the point.
        across: True to measure along the row, False to measure along the column.
        edge: index of the point's own edge.
        projected: (V, 3) u, v and inverse depth of the vertices.
        edges: (E, 2) vertices of each edge.
        nearby_edges: indices of the edges in the band of the point.

    Returns:
        Distance before the point (left or above) and distance after it (right or below).
    """
    before = after = NO_EDGE_DISTANCE
    k = 0 if across else 1
    position, level = (u, v) if across else (v, u)
    first, last = edges[edge]
    for e in nearby_edges:
        if e == edge:
            continue
        i, j = edges[e]
        a, b = projected[i, 1 - k] - level, projected[j, 1 - k] - level
        if a * b > 0.0 or a == b:
            continue
        offset = projected[i, k] + a / (a - b) * (projected[j, k] - projected[i, k]) - position
        if (i in (first, last) or j in (first, last)) and abs(offset) < 0.5:
            continue
        if offset < 0.0:
            before = min(before, -offset)
        else:
            after = min(after, offset)
    return before, after


@jit("f8[:,::1], i8[:,::1], f8[:,::1], i8[:,::1], i8[:,::1], b1[::1], b1[::1], f8[:,::1], "
     "f8[::1], i8, i8, f8")  # fmt: skip
def _sample_edges(vertices, faces, normals, edges, edge_faces, is_crease, is_outermost, T, lens,
                  width, height, spacing):  # fmt: skip
    """Sample the visible edges of a solid in an image without lens distortion.

    Args:
        vertices, faces, normals, edges, edge_faces, is_crease, is_outermost: fields of Solid.
        T: (4, 4) camera_T_solid.
        lens: fx, fy, cx, cy, px.
        width, height: size of the image, px.
        spacing: distance between two points on an edge, px.

    Returns:
        The fields of EdgePoints, in order.
    """
    fx, fy, cx, cy = lens
    # u, v (px) and 1/Z of each vertex; 1/Z is set to 0 for a vertex that is too near
    projected = np.zeros((len(vertices), 3))
    for i in range(len(vertices)):
        x, y, depth = transform_point(T, vertices[i])
        if depth > MIN_DEPTH:
            projected[i, 0], projected[i, 1] = fx * (x / depth) + cx, fy * (y / depth) + cy
            projected[i, 2] = 1.0 / depth
    front, grazing = np.zeros(len(faces), np.bool_), np.zeros(len(faces), np.bool_)
    # faces on the camera's side, which can hide a point
    front_faces = np.empty(len(faces), np.int64)
    count = 0
    camera_position = np.empty(3)  # position of the camera in the solid's frame
    for k in range(3):
        camera_position[k] = -T[0, k] * T[0, 3] - T[1, k] * T[1, 3] - T[2, k] * T[2, 3]
    for f in range(len(faces)):
        p = vertices[faces[f, 0]]
        x, y, z = camera_position[0] - p[0], camera_position[1] - p[1], camera_position[2] - p[2]
        towards = normals[f, 0] * x + normals[f, 1] * y + normals[f, 2] * z
        front[f] = towards > 0.0
        distance = np.sqrt(x * x + y * y + z * z)
        grazing[f] = GRAZING_COSINES[0] * distance < towards < GRAZING_COSINES[1] * distance
        if front[f]:
            front_faces[count] = f
            count += 1
    front_faces = front_faces[:count]
    visible_edges = np.empty(len(edges), np.int64)
    count = 0
    for e in range(len(edges)):
        f, g = edge_faces[e]
        if is_crease[e] and (grazing[f] or grazing[g]):
            continue
        are_ends_in_front = projected[edges[e, 0], 2] > 0.0 < projected[edges[e, 1], 2]
        if are_ends_in_front and (front[f] != front[g] or (is_crease[e] and front[f])):
            visible_edges[count] = e
            count += 1
    visible_edges = visible_edges[:count]
    solid_points, image_points = np.empty((MAX_POINTS, 3)), np.empty((MAX_POINTS, 2))
    pixel, normal = np.empty((MAX_POINTS, 2)), np.empty((MAX_POINTS, 2))
    gain, room = np.empty((MAX_POINTS, 2)), np.empty((MAX_POINTS, 2))
    edge, facing = np.empty(MAX_POINTS, np.int64), np.empty((MAX_POINTS, 2), np.bool_)
    row_first, row_members = _sort_into_bands(projected, edges, visible_edges, 1, height)
    column_first, column_members = _sort_into_bands(projected, edges, visible_edges, 0, width)
    found, next_distance = 0, 0.5 * spacing
    for e in visible_edges:
        i, j = edges[e]
        du, dv = projected[j, 0] - projected[i, 0], projected[j, 1] - projected[i, 1]
        length = np.sqrt(du * du + dv * dv)
        ends = END_MARGIN if length > SHORT_EDGE else 0.0
        if length <= 0.0:
            continue
        if length > SHORT_EDGE:
            next_distance = ends + 0.5 * ((length - 2.0 * ends) % spacing)
        while next_distance < length - ends and found < MAX_POINTS:
            s = next_distance / length
            next_distance += spacing
            u, v = projected[i, 0] + s * du, projected[i, 1] + s * dv
            if not (BORDER < u < width - BORDER and BORDER < v < height - BORDER):
                continue
            w = projected[i, 2] + s * (projected[j, 2] - projected[i, 2])
            a, b = edge_faces[e]
            # An edge of a visible outermost face is never hidden, because no part of the solid is
            # in front of the plane of this face.
            is_never_hidden = (front[a] and is_outermost[a]) or (front[b] and is_outermost[b])
            if not is_never_hidden and _is_hidden(u, v, w, projected, faces, front_faces, a, b):
                continue
            # s is the fraction of the edge's length in the image, `part` the fraction of its length
            # in space.
            part = s * projected[j, 2] / w
            for k in range(3):
                solid_points[found, k] = vertices[i, k] + part * (vertices[j, k] - vertices[i, k])
            image_points[found, 0], image_points[found, 1] = (u - cx) / fx, (v - cy) / fy
            pixel[found, 0], pixel[found, 1] = u, v
            normal[found, 0], normal[found, 1] = dv / length, -du / length
            gain[found, 0], gain[found, 1] = fx * normal[found, 0], fy * normal[found, 1]
            across = abs(dv) >= abs(du)
            if across:
                k = int(v / BAND)
                near = row_members[row_first[k] : row_first[k + 1]]
            else:
                k = int(u / BAND)
                near = column_members[column_first[k] : column_first[k + 1]]
            room[found, 0], room[found, 1] = _measure_room(u, v, across, e, projected, edges, near)
            edge[found], facing[found, 0], facing[found, 1] = e, front[a], front[b]
            found += 1
        next_distance = 0.5 * spacing if length > SHORT_EDGE else next_distance - length
    return (solid_points[:found], image_points[:found], pixel[:found], normal[:found],
            gain[:found], room[:found], edge[:found], facing[:found])  # fmt: skip
