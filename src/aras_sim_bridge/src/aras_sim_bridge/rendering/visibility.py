"""Which triangles faces can show: box by box, then triangle by triangle.

A software rasteriser spends more on a triangle that it must clip than on ten that it draws, so
exact culling here pays for itself several times over.
"""

from __future__ import annotations

import numpy as np

from .clusters import Clusters
from .faces import Faces


class Visibility:
    """The visible triangles of one scene."""

    def __init__(self, clusters: Clusters, rows: int) -> None:
        self._c = c = clusters
        low, high = np.full((rows, 3), np.inf), np.full((rows, 3), -np.inf)
        np.minimum.at(low, c.row, c.centre - c.half)
        np.maximum.at(high, c.row, c.centre + c.half)
        used = np.isfinite(low).all(axis=1)
        self._rows = np.flatnonzero(used)
        self._centre, self._half = (low + high)[used] / 2, (high - low)[used] / 2
        order = np.argsort(c.row, kind="stable")
        ends = np.searchsorted(c.row[order], np.arange(rows + 1))
        self._clusters_of = [order[a:b] for a, b in zip(ends[:-1], ends[1:], strict=True)]

    def of_face(self, faces: Faces, number: int, optical_T_link: np.ndarray
                ) -> tuple[np.ndarray, np.ndarray]:
        """Triangles (N,) that face `number` may show and that turn their front to the eye.

        Also their bounds in the face, (4, N): low x, low y, high x, high y, within -1..1.
        """
        T = optical_T_link
        if faces.rotation is not None:
            T = T.copy()
            T[:, :3] = faces.rotation[number] @ T[:, :3]
        normals = faces.normals(number)
        rows = self._rows
        centre = (T[rows, :3, :3] @ self._centre[:, :, None])[..., 0] + T[rows, :3, 3]
        spans = np.abs(normals @ T[rows, :3, :3])  # (rows, 5, 3)
        reach = (spans @ self._half[:, :, None])[..., 0]
        found = []
        for k in np.flatnonzero(_touches(centre @ normals.T, reach, faces)):
            found.append(self._of_row(rows[k], T[rows[k]], normals, spans[k], faces))
        if not found:
            return np.zeros(0, int), np.zeros((4, 0))
        triangle = np.concatenate(found)
        bounds = self._bounds(triangle, T, faces, number)
        seen = (bounds[0] < 1.0) & (bounds[1] < 1.0) & (bounds[2] > -1.0) & (bounds[3] > -1.0)
        return triangle[seen], bounds[:, seen]

    def _of_row(self, row: int, T: np.ndarray, normals: np.ndarray, spans: np.ndarray,
                faces: Faces) -> np.ndarray:
        """Triangles of one link in clusters that touch the frustum, fronts only."""
        c, chosen = self._c, self._clusters_of[row]
        centre = c.centre[chosen] @ T[:3, :3].T + T[:3, 3]
        chosen = chosen[_touches(centre @ normals.T, c.half[chosen] @ spans.T, faces)]
        count = c.count[chosen]
        ends = np.cumsum(count)
        if not len(ends):
            return np.zeros(0, int)
        triangle = np.arange(ends[-1]) + np.repeat(c.first[chosen] - ends + count, count)
        eye = -T[:3, 3] @ T[:3, :3]
        return triangle[c.normal[triangle] @ eye > c.offset[triangle]]

    def _bounds(self, triangle: np.ndarray, T: np.ndarray, faces: Faces, number: int
                ) -> np.ndarray:
        """(4, N) bounds of triangles in a face; of the part beyond the near plane."""
        c = self._c
        T = T[c.tri_row[triangle]]
        p = c.corners[triangle] @ T[:, :3, :3].transpose(0, 2, 1) + T[:, None, :3, 3]
        x, y, z = p[..., 0], p[..., 1], p[..., 2]
        near = faces.near
        front = z > near
        bounds = np.empty((4, len(triangle)))
        cut = np.flatnonzero(~(front[:, 0] & front[:, 1] & front[:, 2]))
        safe = np.maximum(z, near)
        _extremes(x / safe, y / safe, bounds)
        if len(cut):
            bounds[:, cut] = _cut_bounds(p[cut], near)
        a, b, c_, d = faces.projection[number]
        bounds *= np.array([[a], [c_], [a], [c_]])
        bounds += np.array([[b], [d], [b], [d]])
        return bounds

    def of_tiles(self, triangle: np.ndarray, bounds: np.ndarray, first: np.ndarray,
                 last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pairs (triangle, tile) that overlap, tile by tile.

        triangle, bounds: from of_face. first, last: (F, 2) corners of the tiles in that face.
        """
        low_x, low_y, high_x, high_y = bounds
        overlap = (high_x > first[:, :1]) & (low_x < last[:, :1])
        overlap &= (high_y > first[:, 1:]) & (low_y < last[:, 1:])
        tile, index = np.nonzero(overlap)
        return triangle[index], tile


    def of_rotated(self, triangle: np.ndarray, faces: Faces, optical_T_link: np.ndarray
                   ) -> tuple[np.ndarray, np.ndarray]:
        """Pairs (triangle, face) that may overlap, face by face, for faces with own axes."""
        c = self._c
        T = optical_T_link[c.tri_row[triangle]]
        p = c.corners[triangle] @ T[:, :3, :3].transpose(0, 2, 1) + T[:, None, :3, 3]
        a, _, d, _ = faces.projection.T
        one, zero = np.ones_like(a), np.zeros_like(a)
        normals = np.stack([np.stack([a, zero, one], -1), np.stack([-a, zero, one], -1),
                            np.stack([zero, d, one], -1), np.stack([zero, -d, one], -1)], axis=1)
        normals = (normals @ faces.rotation).reshape(-1, 3)
        side = (p.reshape(-1, 3) @ normals.T).reshape(len(triangle), 3, len(a), 4)
        outside = (side < 0.0).all(axis=1).any(axis=2)
        face, index = np.nonzero(~outside.T)
        return triangle[index], face


def _touches(offset: np.ndarray, reach: np.ndarray, faces: Faces) -> np.ndarray:
    """Whether boxes touch the frustum: distances (N, 5) of centres to the planes, and reaches."""
    high = offset + reach
    return ((high[:, 0] > 0.0) & (high[:, 1] > 0.0) & (high[:, 2] > 0.0) & (high[:, 3] > 0.0)
            & (high[:, 4] > faces.near) & (offset[:, 4] - reach[:, 4] < faces.far))


def _extremes(u: np.ndarray, v: np.ndarray, out: np.ndarray) -> None:
    """Low and high of (N, 3) corner coordinates, written to (4, N)."""
    for row, (values, pick) in enumerate(((u, np.minimum), (v, np.minimum),
                                          (u, np.maximum), (v, np.maximum))):
        pick(pick(values[:, 0], values[:, 1]), values[:, 2], out=out[row])


def _cut_bounds(p: np.ndarray, near: float) -> np.ndarray:
    """(4, N) bounds in x / z, y / z of triangles (N, 3, 3), cut off at z = near."""
    q = np.roll(p, -1, axis=1)
    z, w = p[..., 2], q[..., 2]
    crosses = (z > near) != (w > near)
    s = np.where(crosses, (near - z) / np.where(crosses, w - z, 1.0), 0.0)
    on_plane = (p + s[..., None] * (q - p))[..., :2] / near
    inner = p[..., :2] / np.maximum(z, near)[..., None]
    points = np.concatenate([inner, on_plane], axis=1)
    valid = np.concatenate([z > near, crosses], axis=1)[..., None]
    low = np.where(valid, points, np.inf).min(axis=1)
    high = np.where(valid, points, -np.inf).max(axis=1)
    return np.concatenate([low, high], axis=1).T
