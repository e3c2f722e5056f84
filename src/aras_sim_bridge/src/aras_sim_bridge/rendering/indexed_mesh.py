"""Mesh: indexed triangles, and how they are made of loose ones.

Positions (V, 3) and unit normals (V, 3) float32, triangles (T, 3) int32, optionally texture
coordinates (V, 2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import RenderingError

# Faces that meet at less than this angle are shaded as one smooth surface.
CREASE_ANGLE = np.radians(35.0)


@dataclass(frozen=True)
class Mesh:
    """positions (V, 3), normals (V, 3), triangles (T, 3) counter-clockwise seen from outside."""

    positions: np.ndarray
    normals: np.ndarray
    triangles: np.ndarray
    uv: np.ndarray | None = None
    texture: str | None = None
    rgba: tuple[float, float, float, float] | None = None

    def transformed(self, a_T_b: np.ndarray, scale: np.ndarray | float = 1.0) -> Mesh:
        """The mesh scaled, then carried from frame b to frame a by (4, 4) a_T_b."""
        scale = np.broadcast_to(np.asarray(scale, dtype=float), (3,))
        positions = (self.positions * scale) @ a_T_b[:3, :3].T + a_T_b[:3, 3]
        normals = (self.normals / scale) @ a_T_b[:3, :3].T
        normals = normalised(normals)
        triangles = self.triangles[:, ::-1] if np.prod(scale) < 0 else self.triangles
        return Mesh(
            positions.astype(np.float32), normals.astype(np.float32), triangles,
            self.uv, self.texture, self.rgba,
        )


def normalised(v: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) scaled to length 1; zero stays zero."""
    norm = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.divide(v, norm, out=np.zeros_like(v, dtype=float), where=norm > 1e-20)


def from_corners(corners: np.ndarray, crease: float = CREASE_ANGLE) -> Mesh:
    """Mesh from (T, 3, 3) triangle corners; normals are averaged over faces within `crease` rad."""
    corners = np.asarray(corners, dtype=float).reshape(-1, 3, 3)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    keep = np.linalg.norm(cross, axis=1) > 1e-18
    corners, cross = corners[keep], cross[keep]
    if not len(corners):
        raise RenderingError("mesh has no triangle with an area")
    flat = corners.reshape(-1, 3)
    size = np.ptp(flat, axis=0).max() or 1.0
    _, point = np.unique(np.round(flat / (size * 1e-6)).astype(np.int64), axis=0,
                         return_inverse=True)
    point = point.reshape(-1)
    face_normal = normalised(cross)
    normals = _smooth(point, np.repeat(cross, 3, axis=0), np.repeat(face_normal, 3, axis=0),
                      np.cos(crease))
    key = np.concatenate([point[:, None], np.round(normals * 1e4).astype(np.int64)], axis=1)
    _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return Mesh(flat[first].astype(np.float32), normals[first].astype(np.float32),
                inverse.reshape(-1, 3).astype(np.int32))


def from_indices(
    index: np.ndarray, v: np.ndarray, vt: np.ndarray, vn: np.ndarray,
    rgba: tuple[float, float, float, float] | None, texture: str | None,
) -> Mesh:
    """Mesh of a file that counts positions, texture coordinates and normals apart.

    index: (T, 3 corners, 3) numbers into v (V, 3), vt (., 2) and vn (., 3), -1 where one lacks.
    Normals are made where a corner has none; a texture without coordinates is left out.
    """
    textured = texture is not None and len(vt) and (index[..., 1] >= 0).all()
    if not textured:
        texture = None
    if not (len(vn) and (index[..., 2] >= 0).all()) and not textured:
        mesh = from_corners(v[index[..., 0]])
        return Mesh(mesh.positions, mesh.normals, mesh.triangles, rgba=rgba)
    flat = index.reshape(-1, 3)
    key, inverse = np.unique(flat, axis=0, return_inverse=True)
    positions = v[key[:, 0]]
    triangles = inverse.reshape(-1, 3)
    if len(vn) and (index[..., 2] >= 0).all():
        n = vn[key[:, 2]]
    else:
        n = np.zeros_like(positions)
        corners = positions[triangles]
        face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        np.add.at(n, triangles.reshape(-1), np.repeat(face, 3, axis=0))
    n = n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-20)
    uv = vt[key[:, 1]].astype(np.float32) if textured else None
    return Mesh(positions.astype(np.float32), n.astype(np.float32), triangles.astype(np.int32),
                uv, texture, rgba)


def _smooth(point: np.ndarray, weighted: np.ndarray, unit: np.ndarray, cosine: float) -> np.ndarray:
    """Corner normals: the area-weighted mean over the faces at a point within the crease angle."""
    order = np.argsort(point, kind="stable")
    counts = np.bincount(point)
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    start, count = starts[point[order]], counts[point[order]]
    rank = np.arange(len(order)) - start
    total = np.zeros_like(weighted)
    # Corner i of a point meets corner i + k of the same point, for every k there is.
    for shift in range(int(counts.max())):
        some = np.flatnonzero(count > shift)
        corner = order[some]
        other = order[start[some] + (rank[some] + shift) % count[some]]
        near = (unit[corner] * unit[other]).sum(axis=1) >= cosine
        total[corner] += np.where(near[:, None], weighted[other], 0.0)
    return normalised(total)
