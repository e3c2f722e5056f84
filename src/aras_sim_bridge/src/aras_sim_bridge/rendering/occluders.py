"""Large flat quads, such as a table top, that hide everything behind them when they fill the view.

The servo's camera sees little but the table. What lies below it would be transformed, clipped and
rasterised for nothing, and cost more than the rest of the picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .clusters import Clusters
from .faces import Faces

MOST = 8


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
        self._corners = np.array(corners).reshape(-1, 4, 3)

    def filling(self, faces: Faces, T: np.ndarray) -> Backdrop | None:
        """The quad that fills the whole of a single face, or None.

        T: (rows, 4, 4) optical_T_link.
        """
        if not len(self._row):
            return None
        pose = T[self._row]
        p = self._corners @ pose[:, :3, :3].transpose(0, 2, 1) + pose[:, None, :3, 3]
        z = p[..., 2]
        good = (z.min(axis=1) > faces.near) & (z.max(axis=1) < faces.far)
        good = np.flatnonzero(good)
        if not len(good):
            return None
        p = p[good]
        n = np.cross(p[:, 1] - p[:, 0], p[:, 3] - p[:, 0])
        d = (n * p[:, 0]).sum(axis=1)
        # Seen from the front, the quad turns one way round the corners of the view.
        a, b, c, e = faces.projection[0]
        view = np.array([[(x - b) / a, (y - e) / c] for x in (-1, 1) for y in (-1, 1)])
        q = p[..., :2] / p[..., 2:]
        edge = np.roll(q, -1, axis=1) - q
        to = view[None, None] - q[:, :, None]  # (quads, edges, view corners, 2)
        turn = edge[..., None, 0] * to[..., 1] - edge[..., None, 1] * to[..., 0]
        # n . x > d holds at the eye (x = 0) for a front; those turn negatively as y runs down.
        fills = (d < 0.0) & ((turn < 0.0).all(axis=(1, 2)) | (turn > 0.0).all(axis=(1, 2)))
        if not fills.any():
            return None
        # The nearest where the middle of the view meets it.
        n, d, good = n[fills], d[fills], good[fills]
        k = int((d / (n @ [*view.mean(axis=0), 1.0])).argmin())
        vertex, number = self._vertex[good[k]], good[k]
        return Backdrop(np.array([*n[k], d[k]]) / np.linalg.norm(n[k]), int(self._first[number]),
                        int(self._row[number]), vertex["normal"], vertex["rgba"] / 255.0)


def _quad(corners: np.ndarray) -> np.ndarray | None:
    """Outline (4, 3) of two triangles (2, 3, 3) that form a flat convex quad, else None."""
    a, b = corners
    same = (np.abs(a[:, None] - b[None]).max(axis=2) < 1e-9)
    if same.sum() != 2:
        return None
    alone = int(np.flatnonzero(~same.any(axis=1))[0])
    other = b[int(np.flatnonzero(~same.any(axis=0))[0])]
    outline = np.array([a[alone], a[(alone + 1) % 3], other, a[(alone + 2) % 3]])
    edge = np.roll(outline, -1, axis=0) - outline
    normal = np.cross(edge, np.roll(edge, -1, axis=0))
    size = np.linalg.norm(normal, axis=1)
    if size.min() <= 0.0:
        return None
    normal /= size[:, None]
    return outline if (normal @ normal[0]).min() > 1 - 1e-9 else None
