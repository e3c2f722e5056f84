"""Which edges of a solid are seen from where, and points along them in the picture."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from aras_visual_servo_base.compiled import compiled

from ..undistortion import CameraModel
from .solid import Solid

NEAREST = 0.01  # m along the optical axis: nothing nearer is looked for
MOST = 1200  # points of one picture
ENDS, SHORT = 4.0, 16.0  # px left out at the ends of an edge, but of those that are shorter
BORDER = 5.0  # px from the picture's border
# Cosines to the ray between which a face is seen edge-on: a strip, whose two sides are one edge in
# the picture, and which an error of the pose shows or hides.
GRAZING = (-0.01, 0.03)
DEEPER = 2e-3  # part of the depth by which a face has to lie before a point to hide it
FAR = 1e6  # px: no other edge
BAND = 16  # px: edges are sorted by rows and columns into bands as high and as wide
STEP = 1e-4  # of normalised coordinates, for the lens's derivatives


class EdgePoints(NamedTuple):
    """Points (n) on visible edges, as seen from one pose.

    at: (n, 3) m, in the solid's frame. seen: (n, 2) normalised. pixel: (n, 2) of the picture.
    normal: (n, 2) unit, px, to the left along the edge: where the first face beside it is.
    gain: (n, 2) px along that normal for a change of the normalised coordinates.
    room: (n, 2) px along the row or column that is searched, before and behind, to another edge.
    edge: (n,) its number. facing: (n, 2) whether the faces beside it are seen.
    """

    at: np.ndarray
    seen: np.ndarray
    pixel: np.ndarray
    normal: np.ndarray
    gain: np.ndarray
    room: np.ndarray
    edge: np.ndarray
    facing: np.ndarray


def visible_samples(
    solid: Solid, camera: CameraModel, camera_T_solid: np.ndarray, spacing: float
) -> EdgePoints:
    """Points every `spacing` px along the edges that a camera sees, hidden ones left out."""
    hole = camera.pinhole
    points = EdgePoints(*_sampled(
        solid.vertices, solid.faces, solid.normals, solid.edges, solid.beside, solid.creased,
        solid.outermost,
        np.ascontiguousarray(camera_T_solid), np.array([hole.fx, hole.fy, hole.cx, hole.cy]),
        camera.width, camera.height, spacing,
    ))  # fmt: skip
    if not camera.distorted:
        return points
    focal = np.array([hole.fx, hole.fy])
    pixel, normal, gain = _through_lens(camera, points.seen, points.normal, focal)
    inside = ((pixel > BORDER) & (pixel < (camera.width - BORDER, camera.height - BORDER))).all(
        axis=1
    )
    bent = points._replace(pixel=pixel, normal=normal, gain=gain)
    return EdgePoints(*(np.ascontiguousarray(a[inside]) for a in bent))


def _through_lens(
    camera: CameraModel, seen: np.ndarray, normal: np.ndarray, focal: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels, normals and gains (n, 2) of points whose normals hold without the lens."""
    x, y = seen.T
    u, v = camera.project(x, y)
    derivative = np.empty((len(x), 2, 2))  # of pixels by normalised coordinates
    for k, (dx, dy) in enumerate(((STEP, 0.0), (0.0, STEP))):
        more, less = camera.project(x + dx, y + dy), camera.project(x - dx, y - dy)
        derivative[:, 0, k] = (more[0] - less[0]) / (2.0 * STEP)
        derivative[:, 1, k] = (more[1] - less[1]) / (2.0 * STEP)
    along = np.stack([-normal[:, 1], normal[:, 0]], axis=1) / focal
    along = (derivative @ along[:, :, None])[:, :, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    bent = np.stack([along[:, 1], -along[:, 0]], axis=1)
    return np.stack([u, v], axis=1), bent, (bent[:, None] @ derivative)[:, 0]


@compiled("f8, f8, f8, f8[:,::1], i8[:,::1], i8[::1], i8, i8", allocates=False)
def _hidden(u, v, w, flat, faces, ahead, own, other):
    """Whether one of the faces `ahead` but for two lies before the point at u, v, 1/Z = w."""
    for f in ahead:
        if f in (own, other):
            continue
        a, b, c = flat[faces[f, 0]], flat[faces[f, 1]], flat[faces[f, 2]]
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
        if inside and p * a[2] + q * b[2] + r * c[2] > w * (1.0 + DEEPER):
            return True
    return False


@compiled("f8[:,::1], i8[:,::1], i8[::1], i8, i8")
def _bands(flat, edges, shown, axis, size):
    """Of each band of BAND rows (axis 1) or columns (0) the edges `shown` that reach into it: those
    of band i are members[first[i] : first[i + 1]]."""
    count = size // BAND + 1
    first = np.zeros(count + 1, np.int64)
    reach = np.empty((len(shown), 2), np.int64)
    for s in range(len(shown)):
        a, b = flat[edges[shown[s], 0], axis], flat[edges[shown[s], 1], axis]
        reach[s, 0] = max(int(min(a, b) / BAND), 0)
        reach[s, 1] = min(int(max(a, b) / BAND), count - 1)
        for i in range(reach[s, 0], reach[s, 1] + 1):
            first[i + 1] += 1
    for i in range(count):
        first[i + 1] += first[i]
    due, members = first.copy(), np.empty(first[count], np.int64)
    for s in range(len(shown)):
        for i in range(reach[s, 0], reach[s, 1] + 1):
            members[due[i]] = shown[s]
            due[i] += 1
    return first, members


@compiled("f8, f8, b1, i8, f8[:,::1], i8[:,::1], i8[::1]", allocates=False)
def _room(u, v, across, own, flat, edges, near):
    """px from u, v to other edges along the row (`across`) or the column, before and behind; `near`
    are those of its band."""
    before = behind = FAR
    k = 0 if across else 1
    here, level = (u, v) if across else (v, u)
    first, last = edges[own]
    for e in near:
        if e == own:
            continue
        i, j = edges[e]
        a, b = flat[i, 1 - k] - level, flat[j, 1 - k] - level
        if a * b > 0.0 or a == b:
            continue
        away = flat[i, k] + a / (a - b) * (flat[j, k] - flat[i, k]) - here
        if (i in (first, last) or j in (first, last)) and abs(away) < 0.5:
            continue
        if away < 0.0:
            before = min(before, -away)
        else:
            behind = min(behind, away)
    return before, behind


@compiled("f8[:,::1], i8[:,::1], f8[:,::1], i8[:,::1], i8[:,::1], b1[::1], b1[::1], f8[:,::1], "
          "f8[::1], i8, i8, f8")  # fmt: skip
def _sampled(vertices, faces, normals, edges, beside, creased, outermost, T, lens, width, height,
             spacing):  # fmt: skip
    """EdgePoints without the lens."""
    fx, fy, cx, cy = lens
    flat = np.zeros((len(vertices), 3))  # u, v, 1/Z; 1/Z = 0: too near
    for i in range(len(vertices)):
        x, y, z = vertices[i]
        depth = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
        if depth > NEAREST:
            flat[i, 2] = 1.0 / depth
            u = (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) / depth
            v = (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) / depth
            flat[i, 0], flat[i, 1] = fx * u + cx, fy * v + cy
    front, grazing = np.zeros(len(faces), np.bool_), np.zeros(len(faces), np.bool_)
    ahead = np.empty(len(faces), np.int64)  # faces that can hide something
    count = 0
    eye = np.empty(3)  # the camera, in the solid's frame
    for k in range(3):
        eye[k] = -T[0, k] * T[0, 3] - T[1, k] * T[1, 3] - T[2, k] * T[2, 3]
    for f in range(len(faces)):
        p = vertices[faces[f, 0]]
        x, y, z = eye[0] - p[0], eye[1] - p[1], eye[2] - p[2]
        towards = normals[f, 0] * x + normals[f, 1] * y + normals[f, 2] * z
        front[f] = towards > 0.0
        away = np.sqrt(x * x + y * y + z * z)
        grazing[f] = GRAZING[0] * away < towards < GRAZING[1] * away
        if front[f]:
            ahead[count] = f
            count += 1
    ahead = ahead[:count]
    shown = np.empty(len(edges), np.int64)
    count = 0
    for e in range(len(edges)):
        a, b = front[beside[e, 0]], front[beside[e, 1]]
        if creased[e] and (grazing[beside[e, 0]] or grazing[beside[e, 1]]):
            continue
        if (a != b or (creased[e] and a)) and flat[edges[e, 0], 2] > 0.0 < flat[edges[e, 1], 2]:
            shown[count] = e
            count += 1
    shown = shown[:count]
    at, seen, pixel = np.empty((MOST, 3)), np.empty((MOST, 2)), np.empty((MOST, 2))
    normal, gain, room = np.empty((MOST, 2)), np.empty((MOST, 2)), np.empty((MOST, 2))
    edge, facing = np.empty(MOST, np.int64), np.empty((MOST, 2), np.bool_)
    row_first, row_members = _bands(flat, edges, shown, 1, height)
    column_first, column_members = _bands(flat, edges, shown, 0, width)
    found, due = 0, 0.5 * spacing
    for e in shown:
        i, j = edges[e]
        du, dv = flat[j, 0] - flat[i, 0], flat[j, 1] - flat[i, 1]
        length = np.sqrt(du * du + dv * dv)
        ends = ENDS if length > SHORT else 0.0
        if length <= 0.0:
            continue
        if length > SHORT:
            due = ends + 0.5 * ((length - 2.0 * ends) % spacing)
        while due < length - ends and found < MOST:
            s = due / length
            due += spacing
            u, v = flat[i, 0] + s * du, flat[i, 1] + s * dv
            if not (BORDER < u < width - BORDER and BORDER < v < height - BORDER):
                continue
            w = flat[i, 2] + s * (flat[j, 2] - flat[i, 2])
            a, b = beside[e]
            # Before what bounds a face that is seen and outermost there is nothing.
            if not ((front[a] and outermost[a]) or (front[b] and outermost[b])) and _hidden(
                u, v, w, flat, faces, ahead, a, b
            ):
                continue
            part = s * flat[j, 2] / w  # along the edge itself: perspective shortens its far end
            for k in range(3):
                at[found, k] = vertices[i, k] + part * (vertices[j, k] - vertices[i, k])
            seen[found, 0], seen[found, 1] = (u - cx) / fx, (v - cy) / fy
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
            room[found, 0], room[found, 1] = _room(u, v, across, e, flat, edges, near)
            edge[found], facing[found, 0], facing[found, 1] = e, front[a], front[b]
            found += 1
        due = 0.5 * spacing if length > SHORT else due - length
    return (at[:found].copy(), seen[:found].copy(), pixel[:found].copy(), normal[:found].copy(),
            gain[:found].copy(), room[:found].copy(), edge[:found].copy(),
            facing[:found].copy())  # fmt: skip
