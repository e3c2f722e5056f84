"""Which triangles faces can show: box by box, then, where that pays, triangle by triangle.

A software rasteriser spends more on a triangle that it must clip than on ten that it draws, so
exact culling here pays for itself several times over; but of thousands of triangles it throws
away those turned away or out of view itself, as fast.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .clusters import Clusters
from .compiled import compiled
from .faces import Faces
from .occluders import NOWHERE, Backdrop, Occluders
from .outlines import Outlines

# Distance behind a plane up to which things count as lying in it, m.
TOUCHING = 1e-6
# The first triangle of no quad: neither it nor the next is one.
NO_QUAD = -2


@dataclass(frozen=True)
class Seen:
    """What one face may show.

    triangle: (N,) triangles that turn their front to the eye, ascending, with their outlines. Or
        both None where there are many triangles: then cluster (C,) has them, with others that
        are turned away or out of view.
    backdrop: the quad that fills the face and of which nothing is in `triangle`, or None.
    cut: whether some triangle reaches through the backdrop.
    """

    triangle: np.ndarray | None
    outlines: Outlines | None
    cluster: np.ndarray
    backdrop: Backdrop | None = None
    cut: bool = False


class Visibility:
    """The visible triangles of one scene; transparent: (parts,) bool."""

    def __init__(self, clusters: Clusters, transparent: np.ndarray) -> None:
        self._c = clusters
        self._occluders = Occluders(clusters, transparent)

    def in_view(self, faces: Faces, optical_T_link: np.ndarray, most: int) -> Seen:
        """What a single face may show: triangle by triangle if they are not more than `most`."""
        c = self._c
        backdrop = self._occluders.filling(faces, optical_T_link)
        plane, skipped = NOWHERE, NO_QUAD
        if backdrop is not None:
            plane, skipped = backdrop.plane, backdrop.first
        cluster = self._touched(faces, optical_T_link, plane)
        # Of clusters that show a front about a third of the triangles show their backs.
        if 2 * c.count[cluster].sum() > 3 * most:
            return Seen(None, None, cluster)
        triangle, corners, cut = _in_view(
            c.first[cluster], c.count[cluster], c.tri_row, c.normal, c.offset, c.corners,
            optical_T_link, faces.normals[0], plane, skipped, most,
        )
        if len(triangle) > most:
            return Seen(None, None, cluster)
        outlines = Outlines.of(corners, faces.near)
        within = outlines.within(*faces.window())
        return Seen(triangle[within], outlines.of_some(within), cluster, backdrop, cut)

    def on_faces(self, faces: Faces, optical_T_link: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pairs (triangle, face) of what each of several faces may show, face by face.

        What lies behind a quad that fills a face is left out, not the quad.
        """
        c = self._c
        cluster = self._touched(faces, optical_T_link, NOWHERE)
        return _on_faces(c.first[cluster], c.count[cluster], c.tri_row, c.normal, c.offset,
                         c.corners, optical_T_link, faces.normals,
                         self._occluders.planes(faces, optical_T_link), faces.near)

    def _touched(self, faces: Faces, optical_T_link: np.ndarray, plane: np.ndarray) -> np.ndarray:
        """Clusters (C,) with fronts, whose boxes touch a face's frustum before a plane."""
        c = self._c
        return _touched(c.row, c.centre, c.half, c.facing, optical_T_link, faces.normals, plane,
                        faces.near)

    def outlines_on(self, faces: Faces, triangle: np.ndarray, face: np.ndarray,
                    optical_T_link: np.ndarray) -> Outlines:
        """Outlines of pairs from on_faces, each on the plane of its face."""
        c = self._c
        p = _corners_on(triangle, face, c.tri_row, c.corners, optical_T_link, faces.rotation)
        return Outlines.of(p, faces.near)


@compiled("f8[:,:,::1]")
def _eyes(T):
    """(rows, 3) the eye in the frames of the links."""
    eye = np.empty((len(T), 3))
    for row in range(len(T)):
        for k in range(3):
            eye[row, k] = -(T[row, 0, 3] * T[row, 0, k] + T[row, 1, 3] * T[row, 1, k]
                            + T[row, 2, 3] * T[row, 2, k])
    return eye


@compiled("f8[::1], f8, f8[::1]")
def _front(normal, offset, eye):
    """Whether a triangle shows its front to the eye, all in its link's frame."""
    return normal[0] * eye[0] + normal[1] * eye[1] + normal[2] * eye[2] > offset


@compiled("f8[::1], f8[:,::1]")
def _highest(normal, points):
    """The highest of points (3, 3) along a normal (3+,)."""
    high = -np.inf
    for k in range(3):
        x, y, z = points[k]
        high = max(high, normal[0] * x + normal[1] * y + normal[2] * z)
    return high


@compiled("f8[:,::1], f8[:,::1], f8[:,::1]")
def _move(T, points, out):
    """Points (3, 3) in the frame that T leads to, into out."""
    for k in range(3):
        x, y, z = points[k]
        for j in range(3):
            out[k, j] = T[j, 0] * x + T[j, 1] * y + T[j, 2] * z + T[j, 3]


@compiled("f8[::1], f8, f8[::1], f8[::1]")
def _reach(normal, base, centre, half):
    """How far a box reaches along a normal; all but base in its link's frame."""
    distance = base
    for k in range(3):
        distance += normal[k] * centre[k] + abs(normal[k]) * half[k]
    return distance


@compiled("i8[::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1], f8[::1], f8")
def _touched(row, centre, half, facing, T, faces, plane, near):
    """See Visibility._touched; faces (F, 5, 3) normals, plane (4,) n, d."""
    planes = np.empty((5 * len(faces) + 1, 3))
    planes[:-1] = faces.reshape(-1, 3)
    planes[-1] = plane[:3]
    # All in link frames, so that nothing but planes and the eye need be turned.
    normal = np.empty((len(T), len(planes), 3))
    base = np.empty((len(T), len(planes)))
    for r in range(len(T)):
        for p in range(len(planes)):
            x, y, z = planes[p]
            for k in range(3):
                normal[r, p, k] = x * T[r, 0, k] + y * T[r, 1, k] + z * T[r, 2, k]
            base[r, p] = x * T[r, 0, 3] + y * T[r, 1, 3] + z * T[r, 2, 3]
    eye = _eyes(T)
    out = np.empty(len(row), np.int64)
    found = 0
    for c in range(len(row)):
        r = row[c]
        highest = 0.0
        for k in range(3):
            to_eye = eye[r, k] - centre[c, k]
            highest += max(facing[c, k] * to_eye, facing[c, 3 + k] * to_eye)
        if highest <= facing[c, 6] - TOUCHING:
            continue
        if _reach(normal[r, -1], base[r, -1], centre[c], half[c]) <= plane[3] - TOUCHING:
            continue
        for first in range(0, len(planes) - 1, 5):
            p = first
            while p < first + 4 and _reach(normal[r, p], base[r, p], centre[c], half[c]) > 0.0:
                p += 1
            if p == first + 4 and _reach(normal[r, p], base[r, p], centre[c], half[c]) > near:
                out[found] = c
                found += 1
                break
    return out[:found]


@compiled("i8[::1], i8[::1], i8[::1], f8[:,::1], f8[::1], f8[:,:,::1], f8[:,:,::1], f8[:,::1], "
          "f8[::1], i8, i8")
def _in_view(first, count, row, normal, offset, corners, T, sides, plane, skipped, most):
    """Triangles (N,) of stretches [first, first + count) that show a front in view and before the
    plane, their corners (N, 3, 3) in the optical frame, and whether one reaches through the plane.

    sides: (4+, 3), inward normals of the view's sides. skipped: the first of two triangles that do
        not count. Ends after one more than `most` triangles.
    """
    eye = _eyes(T)
    room = min(count.sum(), most + 1)
    triangle = np.empty(room, np.int64)
    p = np.empty((room, 3, 3))
    found = 0
    cut = False
    for n in range(len(first)):
        for t in range(first[n], first[n] + count[n]):
            if found == room:
                break
            at = p[found]
            if not _front(normal[t], offset[t], eye[row[t]]) or t == skipped or t == skipped + 1:
                continue
            _move(T[row[t]], corners[t], at)
            if _highest(plane, at) - plane[3] <= -TOUCHING:
                continue
            side = 0
            while side < 4 and _highest(sides[side], at) > 0.0:
                side += 1
            if side == 4:
                triangle[found] = t
                found += 1
                cut |= -_highest(-plane, at) - plane[3] < -TOUCHING
    return triangle[:found], p[:found], cut


@compiled("i8[::1], i8[::1], i8[::1], f8[:,::1], f8[::1], f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], "
          "f8[:,::1], f8")
def _on_faces(first, count, row, normal, offset, corners, T, sides, planes, near):
    """Pairs (triangle, face) of the triangles of stretches that show a front on faces with sides
    (F, 5, 3), before planes (F, 4)."""
    eye = _eyes(T)
    front = np.empty(count.sum(), np.int64)
    p = np.empty((len(front), 3, 3))
    fronts = 0
    for n in range(len(first)):
        for t in range(first[n], first[n] + count[n]):
            if _front(normal[t], offset[t], eye[row[t]]):
                front[fronts] = t
                _move(T[row[t]], corners[t], p[fronts])
                fronts += 1
    triangle = np.empty(len(sides) * fronts, np.int64)
    face = np.empty_like(triangle)
    found = 0
    for f in range(len(sides)):
        for n in range(fronts):
            side = 0
            while side < 4 and _highest(sides[f, side], p[n]) > 0.0:
                side += 1
            if (side == 4 and _highest(sides[f, 4], p[n]) > near
                    and _highest(planes[f], p[n]) - planes[f, 3] > -TOUCHING):
                triangle[found], face[found] = front[n], f
                found += 1
    return triangle[:found], face[:found]


@compiled("i8[::1], i8[::1], i8[::1], f8[:,:,::1], f8[:,:,::1], f8[:,:,::1]")
def _corners_on(triangle, face, row, corners, T, rotation):
    """(N, 3, 3) corners of triangles (N,) in the frames of faces (N,)."""
    out = np.empty((len(triangle), 3, 3))
    for n in range(len(triangle)):
        t = triangle[n]
        _move(T[row[t]], corners[t], out[n])
        for k in range(3):
            x, y, z = out[n, k]
            for j in range(3):
                turn = rotation[face[n], j]
                out[n, k, j] = turn[0] * x + turn[1] * y + turn[2] * z
    return out
