"""Large flat quads, such as a table top, that hide everything behind them when they fill the view.

The servo's camera sees little but the table. What lies below it would be transformed, clipped and
rasterised for nothing, and cost more than the rest of the picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..description.mesh import normalised
from .clusters import Clusters
from .compiled import compiled
from .faces import Faces

MOST = 8
# A plane before which everything is.
NOWHERE = np.array([0.0, 0.0, 0.0, -np.inf])


@dataclass(frozen=True)
class Backdrop:
    """A quad of one colour and one normal that fills a face.

    plane: (4,) n, d in the optical frame, with n . x > d on the eye's side.
    first: the first of its two triangles. row: of its link in `Scene.poses`.
    normal: (3,), unit, in the link frame. rgba: (4,) albedo, 0..1.
    """

    plane: np.ndarray
    first: int
    row: int
    normal: np.ndarray
    rgba: np.ndarray


class Occluders:
    """The largest opaque rectangles of a scene.

    transparent: (parts,) bool, of the scene's parts.
    """

    def __init__(self, clusters: Clusters, transparent: np.ndarray) -> None:
        found = []
        for cluster in np.flatnonzero(clusters.count == 2):
            first = clusters.first[cluster]
            if transparent[clusters.part[first]]:
                continue
            corners = _quad(clusters.corners[first:first + 2])
            vertex = clusters.vertices[clusters.indices[first:first + 2].reshape(-1)]
            flat = (vertex["normal"] == vertex["normal"][0]).all() and vertex["uv"][0, 2] < 0
            if corners is not None and flat:
                size = np.linalg.norm(np.cross(corners[1] - corners[0], corners[3] - corners[0]))
                found.append((size, first, clusters.row[cluster], corners, vertex[0]))
        found.sort(key=lambda item: -item[0])
        _, first, row, corners, vertex = zip(*found[:MOST], strict=True) if found else [()] * 5
        self._first, self._vertex = first, vertex
        self._row = np.array(row, int)
        corners = np.array(corners).reshape(-1, 4, 3)
        self._origin = corners[:, 0].copy()
        # Points at origin + s u + t v + h n have coordinates h, s, t in this basis.
        u, v = corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0]
        normal = normalised(np.cross(u, v))
        self._basis = np.linalg.inv(np.stack([normal, u, v], axis=2)).transpose(0, 2, 1).copy()
        self._normal = normal

    def filling(self, faces: Faces, T: np.ndarray) -> Backdrop | None:
        """The quad that fills the whole of a single face, or None.

        T: (rows, 4, 4) optical_T_link.
        """
        k = self._fillings(faces, T)[0]
        if k < 0:
            return None
        vertex = self._vertex[k]
        return Backdrop(self._plane(k, T), int(self._first[k]), int(self._row[k]),
                        vertex["normal"], vertex["rgba"] / 255.0)

    def planes(self, faces: Faces, T: np.ndarray) -> np.ndarray:
        """Planes (F, 4), as Backdrop has them, of the quads that fill faces; NOWHERE for none."""
        return np.array([NOWHERE if k < 0 else self._plane(k, T)
                         for k in self._fillings(faces, T)])

    def _plane(self, k: int, T: np.ndarray) -> np.ndarray:
        pose = T[self._row[k]]
        n = pose[:3, :3] @ self._normal[k]
        return np.array([*n, n @ (pose[:3, :3] @ self._origin[k] + pose[:3, 3])])

    def _fillings(self, faces: Faces, T: np.ndarray) -> np.ndarray:
        """(F,) number of the nearest quad that fills each face, or -1."""
        return _fillings(self._row, self._origin, self._basis, T, faces.rotations,
                         faces.projection, faces.near, faces.far)


@compiled("f8[:,::1], f8[:,::1], f8[:,::1], f8, f8, f8")
def _turned(basis, T, rotation, x, y, z):
    """A direction of a face's frame in the coordinates of a quad: T's link frame, then its basis.

    rotation: optical frame to face frame.
    """
    out = np.zeros(3)
    for i in range(3):
        along = rotation[0, i] * x + rotation[1, i] * y + rotation[2, i] * z
        for j in range(3):
            for k in range(3):
                out[k] += along * T[i, j] * basis[j, k]
    return out


@compiled("i8[::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8, f8")
def _fillings(row, origin, basis, T, rotation, projection, near, far):
    """See Occluders._fillings; basis (K, 3, 3) as there, rotation (F, 3, 3) or one for all."""
    out = np.empty(len(projection), np.int64)
    eye = np.empty((len(row), 3))
    for k in range(len(row)):
        pose, from_origin = T[row[k]], -origin[k]
        for j in range(3):
            for i in range(3):
                from_origin[j] -= pose[i, 3] * pose[i, j]
        for j in range(3):
            eye[k, j] = (from_origin * basis[k, :, j]).sum()
    for f in range(len(projection)):
        a, b, c, d = projection[f]
        turn = rotation[f % len(rotation)]
        nearest, out[f] = np.inf, -1
        for k in range(len(row)):
            total = 0.0
            for corner in range(4):
                # Where the ray through a corner of the face meets the quad, in its coordinates.
                x, y = (2.0 * (corner % 2) - 1.0 - b) / a, (2.0 * (corner // 2) - 1.0 - d) / c
                ray = _turned(basis[k], T[row[k]], turn, x, y, 1.0)
                depth = -eye[k, 0] / ray[0]
                s, t = eye[k, 1] + depth * ray[1], eye[k, 2] + depth * ray[2]
                if not (eye[k, 0] > 0.0 and near < depth < far and 0.0 < s < 1.0 and 0.0 < t < 1.0):
                    break
                total += depth
            else:
                if total < nearest:
                    nearest, out[f] = total, k
    return out


def _quad(corners: np.ndarray) -> np.ndarray | None:
    """Outline (4, 3) of two triangles (2, 3, 3) that form a parallelogram, else None."""
    a, b = corners
    same = (np.abs(a[:, None] - b[None]).max(axis=2) < 1e-9)
    if same.sum() != 2:
        return None
    alone = int(np.flatnonzero(~same.any(axis=1))[0])
    other = b[int(np.flatnonzero(~same.any(axis=0))[0])]
    outline = np.array([a[alone], a[(alone + 1) % 3], other, a[(alone + 2) % 3]])
    size = np.abs(outline - outline[0]).max()
    flaw = np.abs(outline[0] - outline[1] + outline[2] - outline[3]).max()
    area = np.linalg.norm(np.cross(outline[1] - outline[0], outline[3] - outline[0]))
    return outline if flaw < 1e-6 * size and area > 0.0 else None
