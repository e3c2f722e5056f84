"""Large flat quads, such as a table top, that hide everything behind them when they fill the view.

The servo's camera sees little but the table. What lies below it would be transformed, clipped and
rasterised for nothing, and cost more than the rest of the picture.
"""

from __future__ import annotations

import numpy as np

from .clusters import Clusters
from .faces import Faces

MOST = 8


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
            if corners is not None:
                size = np.linalg.norm(np.cross(corners[1] - corners[0], corners[3] - corners[0]))
                found.append((size, clusters.row[cluster], corners))
        found.sort(key=lambda item: -item[0])
        self._row = np.array([row for _, row, _ in found[:MOST]], int)
        self._corners = np.array([c for _, _, c in found[:MOST]]).reshape(-1, 4, 3)

    def filling(self, faces: Faces, T: np.ndarray) -> np.ndarray | None:
        """Plane (4,) n, d of a quad that fills the whole of a single face, or None.

        In the optical frame, with n . x > d on the eye's side. T: (rows, 4, 4) optical_T_link.
        """
        if not len(self._row):
            return None
        pose = T[self._row]
        p = self._corners @ pose[:, :3, :3].transpose(0, 2, 1) + pose[:, None, :3, 3]
        z = p[..., 2]
        good = (z.min(axis=1) > faces.near) & (z.max(axis=1) < faces.far)
        if not good.any():
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
        n, d = n[fills], d[fills]
        k = int((d / (n @ [*view.mean(axis=0), 1.0])).argmin())
        return np.array([*n[k], d[k]]) / np.linalg.norm(n[k])


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
