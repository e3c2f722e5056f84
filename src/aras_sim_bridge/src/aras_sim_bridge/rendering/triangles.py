"""Triangles of a scene in the frames of their links, grouped into clusters."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from aras_visual_servo_base.memory import ByteLimitedCache

from . import clustering
from .scene import VisualMesh
from .textures import Textures

# Size of the cache for scenes, bytes. The cache is worthwhile because a study renders the same
# scene thousands of times.
CACHE_BYTES = 1 << 24
# A visual is tested for convexity if its number of vertices times its number of triangles is at
# most MOST_CONVEX_TESTS. FLAT is the tolerance of the test, relative to the size of the visual; it
# is needed because meshes have single precision.
MOST_CONVEX_TESTS, FLAT = 1 << 22, 1e-6


@dataclass(frozen=True)
class Clusters:
    """C clusters of neighbouring triangles with similar normals.

    The renderer skips invisible clusters without testing their triangles one by one. Clusters with
    large triangles come first, because these hide others.

    Attributes:
        first, count: (C,) index of the first triangle and number of triangles of each cluster.
        row: (C,) row of the cluster's link in the poses of the scene.
        centre, half: (C, 3) centre and half sides of the bounding box in the link frame, m.
        radius: (C,) radius of the bounding sphere around the centre, m.
        axis, cosine: (C, 3), (C,) axis of the cone that contains all normals of the cluster, and
            cosine of its half angle.
        height: (C,) smallest value of n . (p - centre) among the cluster's triangles, m, where n is
            the normal and p a point of a triangle.
        opaque: (C,) bool, whether the triangles are opaque.
        quad: (C,) bool, whether the cluster is a flat convex quadrilateral of one colour, made of
            two triangles. The first corner of each triangle is then the one that the other triangle
            lacks.
    """

    first: np.ndarray
    count: np.ndarray
    row: np.ndarray
    centre: np.ndarray
    half: np.ndarray
    radius: np.ndarray
    axis: np.ndarray
    cosine: np.ndarray
    height: np.ndarray
    opaque: np.ndarray
    quad: np.ndarray


@dataclass(frozen=True)
class Triangles:
    """T triangles of all visuals, cluster by cluster.

    The visuals are numbered in the order in which they were given.

    Attributes:
        clusters: clusters of the triangles.
        row_centre, row_half: (rows, 3) centre and half sides of each link's bounding box, m. The
            half sides are -1 if the link has no triangles.
        corners: (T, 3, 3) corners in the link frame, m.
        normals: (T, 3, 3) normals at the corners in the link frame.
        plane: (T, 4) normal n and distance d of the plane, whose points x fulfil n . x = d.
        row: (T,) row of the triangle's link in the poses of the scene.
        part: (T,) number of the visual to which a triangle belongs.
        smooth: (T,) this number if the visual has no texture, -1 otherwise. The colour of a visual
            without texture varies only with the light.
        hull: (T,) this number if the visual is convex, -1 otherwise. The triangles of a convex
            visual do not hide each other.
        albedo: (T, 4) red, green and blue, 0..255, and opacity, 0..1.
        uv: (T, 3, 2) texture coordinates at the corners.
        layer: (T,) start of the texture in Textures.texels; -1 if there is no texture.
        textures: textures of the visuals.
    """

    clusters: Clusters
    row_centre: np.ndarray
    row_half: np.ndarray
    corners: np.ndarray
    normals: np.ndarray
    plane: np.ndarray
    row: np.ndarray
    part: np.ndarray
    smooth: np.ndarray
    hull: np.ndarray
    albedo: np.ndarray
    uv: np.ndarray
    layer: np.ndarray
    textures: Textures

    @cached_property
    def facets(self) -> np.ndarray:
        """Number (T,) that flat triangles of the same visual with the same normal have in common.

        All triangles of a visual that are not flat-shaded share one number. The number is -1 if the
        visual has a texture.
        """
        flat = (self.normals == self.normals[:, :1]).all(axis=(1, 2))
        turned = np.where(flat[:, None], np.rint(1e4 * self.normals[:, 0]), 2e4).astype(np.int64)
        key = ((self.part * 40001 + turned[:, 0]) * 40001 + turned[:, 1]) * 40001 + turned[:, 2]
        number = np.unique(key, return_inverse=True)[1]
        return np.where(self.smooth < 0, -1, number)

    @property
    def nbytes(self) -> int:
        """Memory that the arrays of triangles, clusters and textures use, bytes."""
        arrays = [getattr(self, f.name) for f in fields(self)]
        arrays += [getattr(self.clusters, f.name) for f in fields(self.clusters)]
        return sum(a.nbytes for a in arrays if isinstance(a, np.ndarray)) + (
            self.textures.texels.nbytes)

    @classmethod
    def from_visuals(cls, visuals: list[VisualMesh]) -> Triangles:
        """Return the triangles of these visuals, from a cache that all renderers share."""
        return _cache.get(_make_key(visuals), lambda: cls._build(visuals))

    @classmethod
    def _build(cls, visuals: list[VisualMesh]) -> Triangles:
        textures = Textures({part.mesh.texture for part in visuals if part.mesh.texture})
        corners, normals, uv = ([np.zeros((0, 3, n))] for n in (3, 3, 2))
        albedo = [np.zeros((0, 4))]
        layer, row, number = ([np.zeros(0, int)] for _ in range(3))
        convex = [n for n, part in enumerate(visuals) if _is_convex(part)]
        for n, part in enumerate(visuals):
            mesh, count = part.mesh, len(part.mesh.triangles)
            corners.append(mesh.positions[mesh.triangles].astype(float))
            normals.append(mesh.normals[mesh.triangles].astype(float))
            known = mesh.texture is not None and mesh.uv is not None
            uv.append(mesh.uv[mesh.triangles].astype(float) if known else np.zeros((count, 3, 2)))
            albedo.append(np.tile(np.clip(part.rgba, 0.0, 1.0) * [255, 255, 255, 1], (count, 1)))
            layer.append(np.full(count, textures.find_layer(mesh.texture) if known else -1))
            row.append(np.full(count, part.row))
            number.append(np.full(count, n))
        lists = [np.concatenate(one) for one in (corners, normals, albedo, uv, layer, row, number)]
        area = np.cross(lists[0][:, 1] - lists[0][:, 0], lists[0][:, 2] - lists[0][:, 0])
        size = np.linalg.norm(area, axis=1)
        lists = [one[size > 0.0] for one in lists]
        unit, size = area[size > 0.0] / size[size > 0.0, None], size[size > 0.0]
        groups = clustering.cluster_triangles(lists[0], unit, lists[6])
        groups.sort(key=lambda group: -size[group].max())
        order = np.concatenate([np.zeros(0, int), *groups])
        corners, normals, albedo, uv, layer, row, number = (one[order].copy() for one in lists)
        unit = unit[order]
        counts = np.array([len(group) for group in groups], int)
        first = np.cumsum(counts) - counts
        quad = np.zeros(len(counts), bool)
        for n in np.flatnonzero(counts == 2):
            two = slice(first[n], first[n] + 2)
            flat = (normals[two] == normals[first[n], 0]).all() and layer[first[n]] < 0
            corners_apart = _find_quad(corners[two]) if flat else None
            if corners_apart is not None:
                quad[n] = True
                for k, turn in enumerate(corners_apart):
                    corners[first[n] + k] = np.roll(corners[first[n] + k], -turn, axis=0)
        hull = np.where(np.isin(number, convex), number, -1)
        smooth = np.where(layer < 0, number, -1)
        plane = np.concatenate([unit, (unit * corners[:, 0]).sum(axis=1)[:, None]], axis=1)
        clusters = _make_clusters(first, counts, corners, plane, row, albedo, quad)
        return cls(
            clusters,
            *_compute_boxes(corners, row),
            corners,
            normals,
            plane,
            row,
            number,
            smooth,
            hull,
            albedo,
            uv,
            layer,
            textures,
        )


def _is_convex(part: VisualMesh) -> bool:
    """Return whether a visual is convex; False if it has too many triangles for the test."""
    mesh = part.mesh
    points = np.unique(mesh.positions.astype(float), axis=0)
    if not 0 < len(points) * len(mesh.triangles) <= MOST_CONVEX_TESTS:
        return False
    a, b, c = mesh.positions[mesh.triangles].astype(float).swapaxes(0, 1)
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
    before = normal @ points.T - (normal * a).sum(axis=1)[:, None]
    return bool(before.max() <= FLAT * np.ptp(points, axis=0).max())


def _compute_boxes(corners: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounding box of each link's triangles as (centres, half sides), (rows, 3) each.

    The box is in the link frame, m. Its half sides are -1 if the link has no triangles.

    Args:
        corners: (T, 3, 3) corners of the triangles in the link frame, m.
        row: (T,) row of each triangle's link.
    """
    rows = row.max(initial=-1) + 1
    low, high = np.full((rows, 3), np.inf), np.full((rows, 3), -np.inf)
    np.minimum.at(low, row, corners.min(axis=1))
    np.maximum.at(high, row, corners.max(axis=1))
    none = low[:, :1] > high[:, :1]
    low, high = np.where(none, 1.0, low), np.where(none, -1.0, high)
    return (low + high) / 2, (high - low) / 2


_cache: ByteLimitedCache[bytes, Triangles] = ByteLimitedCache(CACHE_BYTES)


def _make_key(parts: list[VisualMesh]) -> bytes:
    """Return a checksum of the visuals, the key of the cache.

    It includes the modification times of the texture files.
    """
    key = hashlib.blake2b(digest_size=16)
    for part in parts:
        mesh = part.mesh
        when = 0
        if mesh.texture and os.path.exists(mesh.texture):
            when = os.stat(mesh.texture).st_mtime_ns
        shapes = [None if a is None else (a.shape, a.dtype.str) for a in _list_arrays(part)]
        key.update(repr((part.row, part.rgba, mesh.texture, when, shapes)).encode())
        for array in _list_arrays(part):
            if array is not None:
                key.update(np.ascontiguousarray(array))
    return key.digest()


def _list_arrays(part: VisualMesh) -> tuple[np.ndarray | None, ...]:
    return part.mesh.positions, part.mesh.normals, part.mesh.triangles, part.mesh.uv


def _find_quad(corners: np.ndarray) -> tuple[int, int] | None:
    """Test whether two triangles (2, 3, 3) form a flat convex quad.

    Return, for each triangle, the index of the corner that is not on the common side. Return None
    if the triangles do not form such a quad.
    """
    a, b = corners
    same = (a[:, None] == b[None]).all(axis=2)
    if same.sum() != 2:
        return None
    i, j = int(np.argmin(same.any(axis=1))), int(np.argmin(same.any(axis=0)))
    outline = np.array([a[i], a[(i + 1) % 3], b[j], a[(i + 2) % 3]])
    side = np.roll(outline, -1, axis=0) - outline
    turn = np.cross(side, np.roll(side, -1, axis=0))
    normal = turn.sum(axis=0)
    # The normal is perpendicular to both diagonals of the quadrilateral by construction. The
    # quadrilateral is flat if one side is perpendicular to the normal, too, up to the rounding of
    # mesh coordinates with seven digits.
    near = 1e-6 * np.abs(side).max() + 2e-7 * np.abs(outline).max()
    flat = abs(side[0] @ normal) <= near * np.linalg.norm(normal)
    return (i, j) if flat and (turn @ normal > 0.0).all() else None


def _make_clusters(first: np.ndarray, count: np.ndarray, corners: np.ndarray, plane: np.ndarray,
              row: np.ndarray, albedo: np.ndarray, quad: np.ndarray) -> Clusters:
    if not len(first):
        empty, none = np.zeros((0, 3)), np.zeros(0)
        return Clusters(first, count, none.astype(int), empty, empty, none, empty, none, none,
                        none.astype(bool), quad)
    low = np.minimum.reduceat(corners.min(axis=1), first)
    high = np.maximum.reduceat(corners.max(axis=1), first)
    centre, half = (low + high) / 2, (high - low) / 2
    # number of the cluster that each triangle belongs to
    mine = np.repeat(np.arange(len(first)), count)
    away = np.linalg.norm(corners - centre[mine, None], axis=2).max(axis=1)
    radius = np.maximum.reduceat(away, first)
    axis = np.add.reduceat(plane[:, :3], first)
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    cosine = np.minimum.reduceat((plane[:, :3] * axis[mine]).sum(axis=1), first).clip(-1.0, 1.0)
    above = plane[:, 3] - (plane[:, :3] * centre[mine]).sum(axis=1)
    height = np.minimum.reduceat(above, first)
    return Clusters(first, count, row[first], centre, half, radius, axis, cosine, height,
                    albedo[first, 3] >= 1.0, quad)
