"""Cuts meshes into small clusters of neighbouring triangles, each drawn or skipped as a whole.

A camera near the robot sees a small part of it. Skipping by cluster keeps the vertex work in
proportion to what is seen, whatever the size of the meshes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .scene import Part

CLUSTER_TRIANGLES = 96


@dataclass(frozen=True)
class Clusters:
    """Vertices and triangles of all parts, in link frames, cluster by cluster.

    vertices: (V,) records of position, normal, colour, uv.
    indices: (3 T,) uint32.
    first, count: (C,) ranges of `indices`; row: (C,) row of the link in `Scene.poses`.
    centre (C, 3), radius (C,): bounding spheres in the link frame.
    axis (C, 3), spread (C,): every normal of the cluster lies within a cone about `axis`
        whose half angle has the sine `spread`; 2 where no cone is useful.
    layer: (C,) index of the part's texture, -1 without; transparent: (C,) bool.
    """

    vertices: np.ndarray
    indices: np.ndarray
    first: np.ndarray
    count: np.ndarray
    row: np.ndarray
    centre: np.ndarray
    radius: np.ndarray
    axis: np.ndarray
    spread: np.ndarray
    texture: np.ndarray
    transparent: np.ndarray
    part: np.ndarray


VERTEX = np.dtype([("position", "<f4", 3), ("normal", "<f4", 3), ("rgba", "u1", 4),
                   ("uv", "<f4", 2)])


def build(parts: list[Part], textures: list[str]) -> Clusters:
    """Clusters of all parts; `textures` lists the texture files in layer order."""
    vertices, indices, rows = [], [], []
    base, first = 0, 0
    for number, part in enumerate(parts):
        mesh = part.mesh
        record = np.zeros(len(mesh.positions), VERTEX)
        record["position"] = mesh.positions
        record["normal"] = mesh.normals
        record["rgba"] = np.round(np.clip(part.rgba, 0, 1) * np.array(255))
        if mesh.uv is not None:
            record["uv"] = mesh.uv
        texture = textures.index(mesh.texture) if mesh.texture in textures else -1
        order = _morton_order(mesh.positions[mesh.triangles].mean(axis=1))
        triangles = mesh.triangles[order]
        for start in range(0, len(triangles), CLUSTER_TRIANGLES):
            chunk = triangles[start:start + CLUSTER_TRIANGLES]
            corners = mesh.positions[chunk].astype(float)
            rows.append((first, 3 * len(chunk), part.row, *_sphere(corners.reshape(-1, 3)),
                         *_cone(corners), texture, part.rgba[3] < 1.0, number))
            indices.append((chunk + base).reshape(-1))
            first += 3 * len(chunk)
        vertices.append(record)
        base += len(record)
    columns = list(zip(*rows, strict=True)) if rows else [[] for _ in range(10)]
    c = [np.array(column) for column in columns]
    return Clusters(
        np.concatenate(vertices) if vertices else np.zeros(0, VERTEX),
        np.concatenate(indices).astype(np.uint32) if indices else np.zeros(0, np.uint32),
        c[0].astype(np.uint32), c[1].astype(np.uint32), c[2].astype(np.intp),
        c[3].reshape(-1, 3).astype(float), c[4].astype(float),
        c[5].reshape(-1, 3).astype(float), c[6].astype(float),
        c[7].astype(int), c[8].astype(bool), c[9].astype(int),
    )


def _morton_order(points: np.ndarray) -> np.ndarray:
    """Order along a space-filling curve, so that neighbours in the list are neighbours in space."""
    low, size = points.min(axis=0), max(float(np.ptp(points, axis=0).max()), 1e-12)
    cell = np.minimum((points - low) / size * 1023, 1023).astype(np.int64)
    code = np.zeros(len(points), np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")


def _sphere(points: np.ndarray) -> tuple[np.ndarray, float]:
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    return centre, float(np.linalg.norm(points - centre, axis=1).max())


def _cone(corners: np.ndarray) -> tuple[np.ndarray, float]:
    """Axis and sine of the half angle of the cone that holds the faces' normals."""
    n = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(n, axis=1)
    n = n[length > 0] / length[length > 0, None]
    mean = n.sum(axis=0)
    norm = np.linalg.norm(mean)
    if not len(n) or norm < 1e-9:
        return np.zeros(3), 2.0
    axis = mean / norm
    cosine = float((n @ axis).min())
    return (axis, float(np.sqrt(1 - min(cosine, 1.0) ** 2))) if cosine > 0.0 else (axis, 2.0)
