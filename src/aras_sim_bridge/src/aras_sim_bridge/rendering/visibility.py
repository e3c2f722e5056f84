"""Which triangles faces can show: box by box, then, where that pays, triangle by triangle.

A software rasteriser spends more on a triangle that it must clip than on ten that it draws, so
exact culling here pays for itself several times over; but of thousands of triangles it throws
away those turned away or out of view faster than numpy finds them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .clusters import Clusters
from .faces import Faces
from .occluders import Backdrop, Occluders
from .outlines import Outlines

# Distance behind a plane up to which things count as lying in it, m.
TOUCHING = 1e-6


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
        self._c = c = clusters
        self._occluders = Occluders(clusters, transparent)
        # A box around all clusters of each link.
        self._rows, self._link = np.unique(c.row, return_inverse=True)
        low = np.full((len(self._rows), 3), np.inf)
        high = -low
        np.minimum.at(low, self._link, c.centre - c.half)
        np.maximum.at(high, self._link, c.centre + c.half)
        self._centre, self._half = (low + high) / 2, (high - low) / 2

    def in_view(self, faces: Faces, optical_T_link: np.ndarray, most: int) -> Seen:
        """What a single face may show: triangle by triangle if they are not more than `most`."""
        backdrop = self._occluders.filling(faces, optical_T_link)
        cluster = self._touched(faces, optical_T_link, backdrop)
        # Of clusters that show a front about a third of the triangles show their backs.
        if 2 * self._c.count[cluster].sum() > 3 * most:
            return Seen(None, None, cluster)
        triangle = self._fronts(self._triangles(cluster), optical_T_link)
        if len(triangle) > most:
            return Seen(None, None, cluster)
        p = self._corners(triangle, optical_T_link)
        normals = faces.normals[0]
        side = (p.reshape(-1, 3) @ normals[:4].T).reshape(-1, 3, 4)
        seen = (side.max(axis=1) > 0.0).all(axis=1)
        cut = False
        if backdrop is not None:
            ahead = (p.reshape(-1, 3) @ backdrop.plane[:3]).reshape(-1, 3) - backdrop.plane[3]
            seen &= ahead.max(axis=1) > -TOUCHING
            seen &= (triangle != backdrop.first) & (triangle != backdrop.first + 1)
            cut = bool((ahead[seen] < -TOUCHING).any())
        outlines = Outlines.of(p[seen], faces.near)
        within = outlines.within(*faces.window())
        return Seen(triangle[seen][within], outlines.of_some(within), cluster, backdrop, cut)

    def on_faces(self, faces: Faces, optical_T_link: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pairs (triangle, face) of what each of several faces may show, face by face."""
        cluster = self._touched(faces, optical_T_link)
        triangle = self._fronts(self._triangles(cluster), optical_T_link)
        p = self._corners(triangle, optical_T_link).reshape(-1, 3)
        side = (faces.normals.reshape(-1, 3) @ p.T).reshape(len(faces), 5, -1, 3)
        high = np.maximum(np.maximum(side[..., 0], side[..., 1]), side[..., 2])
        seen = ((high[:, 0] > 0.0) & (high[:, 1] > 0.0) & (high[:, 2] > 0.0)
                & (high[:, 3] > 0.0) & (high[:, 4] > faces.near))
        face, index = np.nonzero(seen)
        return triangle[index], face

    def _touched(self, faces: Faces, T: np.ndarray, backdrop: Backdrop | None = None
                 ) -> np.ndarray:
        """Clusters (C,) with fronts, whose boxes touch a face's frustum before the backdrop."""
        c = self._c
        R, t = T[self._rows, :3, :3], T[self._rows, :3, 3]
        planes = faces.normals.reshape(-1, 3)
        if backdrop is not None:
            planes = np.concatenate([planes, [backdrop.plane[:3]]])
        # All in link frames, so that nothing but planes and the eye need be turned.
        normal = planes @ R  # (rows, 5 F + 1, 3)
        base = t @ planes.T
        eye = -(t[:, None] @ R)[:, 0]
        touched = _in_front(_distance(normal, base, self._centre, self._half), faces, backdrop)
        near = np.flatnonzero(touched[self._link])
        own, centre = self._link[near], c.centre[near]
        facing = c.facing[near]
        to_eye = eye[own] - centre
        highest = np.maximum(facing[:, :3] * to_eye, facing[:, 3:6] * to_eye).sum(axis=1)
        fronts = highest > facing[:, 6] - TOUCHING
        near, own, centre = near[fronts], own[fronts], centre[fronts]
        distance = _distance(normal[own], base[own], centre, c.half[near])
        return near[_in_front(distance, faces, backdrop)]

    def _triangles(self, cluster: np.ndarray) -> np.ndarray:
        """All triangles (N,) of clusters."""
        c = self._c
        count = c.count[cluster]
        ends = np.cumsum(count)
        total = int(ends[-1]) if len(ends) else 0
        return np.arange(total) + np.repeat(c.first[cluster] - ends + count, count)

    def _fronts(self, triangle: np.ndarray, T: np.ndarray) -> np.ndarray:
        """Those of triangles (N,) that turn their front to the eye."""
        c = self._c
        eye = -(T[:, None, :3, 3] @ T[:, :3, :3])[:, 0]
        side = np.einsum("ij,ij->i", c.normal[triangle], eye[c.tri_row[triangle]])
        return triangle[side > c.offset[triangle]]

    def _corners(self, triangle: np.ndarray, T: np.ndarray) -> np.ndarray:
        """(N, 3, 3) corners in the optical frame."""
        pose = T[self._c.tri_row[triangle], :3]
        return self._c.corners[triangle] @ pose[:, :, :3].transpose(0, 2, 1) + pose[:, None, :, 3]

    def outlines_on(self, faces: Faces, triangle: np.ndarray, face: np.ndarray,
                    optical_T_link: np.ndarray) -> Outlines:
        """Outlines of pairs from on_faces, each on the plane of its face."""
        p = self._corners(triangle, optical_T_link) @ faces.rotation[face].transpose(0, 2, 1)
        return Outlines.of(p, faces.near)


def _distance(normal: np.ndarray, base: np.ndarray, centre: np.ndarray, half: np.ndarray
              ) -> np.ndarray:
    """(planes, N) distance of boxes (N, 3) from planes of their own, to their farthest corners.

    normal: (N, planes, 3), in the boxes' frames. base: (N, planes).
    """
    middle = (normal @ centre[:, :, None])[:, :, 0]
    return (middle + base + (np.abs(normal) @ half[:, :, None])[:, :, 0]).T


def _in_front(distance: np.ndarray, faces: Faces, backdrop: Backdrop | None) -> np.ndarray:
    """Which of the boxes with these distances touch any face's frustum, before the backdrop."""
    touched = np.zeros(distance.shape[1], bool)
    for k in range(0, 5 * len(faces), 5):
        touched |= (distance[k:k + 4] > 0.0).all(axis=0) & (distance[k + 4] > faces.near)
    if backdrop is not None:
        touched &= distance[-1] > backdrop.plane[3] - TOUCHING
    return touched
