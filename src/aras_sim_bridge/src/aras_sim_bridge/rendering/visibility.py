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

    def __init__(self, clusters: Clusters) -> None:
        self._c = c = clusters
        # Clusters stand link by link; a box around each link's.
        self._rows = rows = np.unique(c.row)
        ends = np.searchsorted(c.row, [rows, rows + 1]).T.tolist()
        self._clusters_of = {row: slice(*e) for row, e in zip(rows, ends, strict=True)}
        low = np.array([(c.centre - c.half)[slice(*e)].min(axis=0) for e in ends]).reshape(-1, 3)
        high = np.array([(c.centre + c.half)[slice(*e)].max(axis=0) for e in ends]).reshape(-1, 3)
        self._centre, self._half = (low + high) / 2, (high - low) / 2

    def in_view(self, faces: Faces, optical_T_link: np.ndarray, most: int
                ) -> tuple[np.ndarray, np.ndarray | None]:
        """Triangles (N,) that a single face may show and that turn their front to the eye.

        Also their bounds in the face, (4, N): low x, low y, high x, high y, within -1..1; or
        None when there are more than `most` triangles, which are then only looked at one by
        one where their cluster reaches over the border.
        """
        triangle, crossing = self._candidates(faces, optical_T_link)
        if len(triangle) > most:
            test = np.flatnonzero(crossing)
            out = ~_within(self._bounds(triangle[test], optical_T_link, faces))
            keep = np.ones(len(triangle), bool)
            keep[test[out]] = False
            return triangle[keep], None
        bounds = self._bounds(triangle, optical_T_link, faces)
        seen = _within(bounds)
        return triangle[seen], bounds[:, seen]

    def on_faces(self, faces: Faces, optical_T_link: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pairs (triangle, face) of what each of several faces may show, face by face."""
        triangle, _ = self._candidates(faces, optical_T_link)
        p = self._corners(triangle, optical_T_link).reshape(-1, 3)
        side = (faces.normals().reshape(-1, 3) @ p.T).reshape(len(faces), 5, -1, 3)
        high = np.maximum(np.maximum(side[..., 0], side[..., 1]), side[..., 2])
        seen = ((high[:, 0] > 0.0) & (high[:, 1] > 0.0) & (high[:, 2] > 0.0)
                & (high[:, 3] > 0.0) & (high[:, 4] > faces.near))
        face, index = np.nonzero(seen)
        return triangle[index], face

    def _candidates(self, faces: Faces, T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Front triangles in clusters whose boxes touch a face's frustum, ascending.

        And for each, whether its box reaches over the border of the first face.
        """
        rows = self._rows
        R, t = T[rows, :3, :3], T[rows, :3, 3]
        normals = faces.normals().reshape(-1, 3)
        spans = np.abs(normals @ R)  # (rows, 5 F, 3)
        offset = np.einsum("rij,rj->ri", R, self._centre)
        offset += t
        touched, _ = _boxes(offset @ normals.T, np.einsum("rki,ri->rk", spans, self._half), faces)
        found, over = [], []
        for k in np.flatnonzero(touched):
            triangle, crossing = self._in_row(rows[k], R[k], t[k], normals, spans[k], faces)
            found.append(triangle)
            over.append(crossing)
        if not found:
            return np.zeros(0, int), np.zeros(0, bool)
        return np.concatenate(found), np.concatenate(over)

    def _in_row(self, row: int, R: np.ndarray, t: np.ndarray, normals: np.ndarray,
                spans: np.ndarray, faces: Faces) -> tuple[np.ndarray, np.ndarray]:
        """The candidates of one link."""
        c, own = self._c, self._clusters_of[row]
        offset = c.centre[own] @ (normals @ R).T + normals @ t
        touched, crossing = _boxes(offset, c.half[own] @ spans.T, faces)
        chosen = np.flatnonzero(touched)
        crossing, chosen = crossing[chosen], chosen + own.start
        count = c.count[chosen]
        ends = np.cumsum(count)
        if not len(ends):
            return np.zeros(0, int), np.zeros(0, bool)
        triangle = np.arange(ends[-1]) + np.repeat(c.first[chosen] - ends + count, count)
        front = c.normal[triangle] @ (-t @ R) > c.offset[triangle]
        return triangle[front], np.repeat(crossing, count)[front]

    def _corners(self, triangle: np.ndarray, T: np.ndarray) -> np.ndarray:
        """(N, 3, 3) corners in the optical frame."""
        c = self._c
        if not len(triangle):
            return np.zeros((0, 3, 3))
        row = c.tri_row[triangle]
        # Triangles of a link stand together; one product for each.
        edges = np.flatnonzero(np.diff(row)) + 1
        p = c.corners[triangle]
        out = np.empty_like(p)
        for a, b in zip([0, *edges], [*edges, len(row)], strict=True):
            pose = T[row[a]]
            np.matmul(p[a:b].reshape(-1, 3), pose[:3, :3].T, out=out[a:b].reshape(-1, 3))
            out[a:b] += pose[:3, 3]
        return out

    def _bounds(self, triangle: np.ndarray, T: np.ndarray, faces: Faces) -> np.ndarray:
        """(4, N) bounds of triangles in a single face that looks along the optical axis."""
        return _projected_bounds(self._corners(triangle, T), faces.near, faces.projection[0])

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


def _boxes(offset: np.ndarray, reach: np.ndarray, faces: Faces) -> tuple[np.ndarray, np.ndarray]:
    """Whether boxes touch any face's frustum, and whether they reach over the first one's border.

    offset, reach: (N, 5 F) distances of the boxes' centres from the planes, and half extents.
    """
    high, low = (offset + reach).T, (offset - reach).T
    near, far = faces.near, faces.far
    touched = np.zeros(len(offset), bool)
    for k in range(0, len(high), 5):
        touched |= ((high[k] > 0.0) & (high[k + 1] > 0.0) & (high[k + 2] > 0.0)
                    & (high[k + 3] > 0.0) & (high[k + 4] > near) & (low[k + 4] < far))
    crossing = ((low[0] < 0.0) | (low[1] < 0.0) | (low[2] < 0.0) | (low[3] < 0.0)
                | (low[4] < near) | (high[4] > far))
    return touched, crossing


def _projected_bounds(p: np.ndarray, near: float, projection: np.ndarray) -> np.ndarray:
    """(4, N) bounds on a face of triangles (N, 3, 3) in its frame; of the part beyond near."""
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    front = z > near
    bounds = np.empty((4, len(p)))
    cut = np.flatnonzero(~(front[:, 0] & front[:, 1] & front[:, 2]))
    safe = np.maximum(z, near)
    _extremes(x / safe, y / safe, bounds)
    if len(cut):
        bounds[:, cut] = _cut_bounds(p[cut], near)
    a, b, c, d = projection
    bounds *= np.array([[a], [c], [a], [c]])
    bounds += np.array([[b], [d], [b], [d]])
    return bounds


def _within(bounds: np.ndarray) -> np.ndarray:
    """Which of the bounds (4, N) touch the face."""
    return (bounds[0] < 1.0) & (bounds[1] < 1.0) & (bounds[2] > -1.0) & (bounds[3] > -1.0)


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
