"""Cuts meshes into small clusters of neighbouring triangles, so that few need be looked at.

A camera near the robot sees a small part of it. Skipping by cluster keeps the work in proportion
to what is seen, whatever the size of the meshes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..description.mesh import normalised
from .scene import Part

CLUSTER_TRIANGLES = 64
# Smaller groups are cut as well where that saves half of what they would cost.
WORTHWHILE = 0.5
# Connected pieces below this share of a mesh's extent are not told apart.
SMALL_PIECE = 0.1


@dataclass(frozen=True)
class Clusters:
    """Vertices and triangles of all parts, in link frames, cluster by cluster.

    vertices: (V,) records of position, normal, colour, and uv with the texture's layer (-1: none).
    indices (T, 3); corners (T, 3, 3); normal (T, 3) and offset (T,) of each triangle's plane
        n . x = offset; tri_row (T,) row of its link in `Scene.poses`; part (T,) its part.
    first, count, row: (C,) triangles and link of each cluster.
    centre, half: (C, 3), bounding boxes in the link frame, with half their side lengths.
    facing: (C, 7) bounds of what the triangles' planes are seen from the centre, see `_facing`.
    """

    vertices: np.ndarray
    indices: np.ndarray
    corners: np.ndarray
    normal: np.ndarray
    offset: np.ndarray
    tri_row: np.ndarray
    part: np.ndarray
    first: np.ndarray
    count: np.ndarray
    row: np.ndarray
    centre: np.ndarray
    half: np.ndarray
    facing: np.ndarray


VERTEX = np.dtype([("position", "<f4", 3), ("normal", "<f4", 3), ("rgba", "u1", 4),
                   ("uv", "<f4", 3)])


def build(parts: list[Part], textures: list[str]) -> Clusters:
    """Clusters of all parts; `textures` lists the texture files in layer order."""
    vertices = [np.zeros(0, VERTEX)]
    triangles, corners, owner = [np.zeros((0, 3), int)], [np.zeros((0, 3, 3))], []
    clusters = []
    base = first = 0
    for number, part in enumerate(parts):
        mesh = part.mesh
        vertices.append(_records(part, textures))
        mesh_corners = mesh.positions[mesh.triangles].astype(float)
        for group in _groups(mesh_corners):
            triangles.append(mesh.triangles[group] + base)
            corners.append(mesh_corners[group])
            owner += [number] * len(group)
            centre, half = _box(corners[-1])
            clusters.append((first, len(group), part.row, centre, half,
                             _facing(corners[-1], centre)))
            first += len(group)
        base += len(mesh.positions)
    first, count, row, centre, half, facing = (
        zip(*clusters, strict=True) if clusters else [[]] * 6
    )
    all_corners = np.concatenate(corners)
    normal = np.cross(all_corners[:, 1] - all_corners[:, 0], all_corners[:, 2] - all_corners[:, 0])
    part = np.array(owner, int)
    return Clusters(
        np.concatenate(vertices), np.concatenate(triangles).astype(np.uint32), all_corners,
        normal, (normal * all_corners[:, 0]).sum(axis=1),
        np.array([p.row for p in parts], int)[part], part,
        np.array(first, int), np.array(count, int), np.array(row, int),
        np.array(centre, float).reshape(-1, 3), np.array(half, float).reshape(-1, 3),
        np.array(facing, float).reshape(-1, 7),
    )


def _records(part: Part, textures: list[str]) -> np.ndarray:
    mesh = part.mesh
    record = np.zeros(len(mesh.positions), VERTEX)
    record["position"] = mesh.positions
    record["normal"] = mesh.normals
    record["rgba"] = np.round(np.clip(part.rgba, 0, 1) * np.array(255))
    record["uv"][:, 2] = -1
    if mesh.texture in textures:
        record["uv"][:, :2] = mesh.uv
        record["uv"][:, 2] = textures.index(mesh.texture)
    return record


def _groups(corners: np.ndarray) -> list[np.ndarray]:
    """Triangles (T, 3, 3) in groups that face the same side and lie close together.

    Split by connected pieces, so that profiles at opposite ends of a frame are apart; by the axis
    that the normal follows most, so that the backs of things are groups of their own; then in
    two until small.
    """
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    axis = np.abs(normal).argmax(axis=1)
    side = 2 * axis + (normal[np.arange(len(axis)), axis] > 0)
    low, high = corners.min(axis=1), corners.max(axis=1)
    label = 6 * _pieces(corners) + side
    pending = [np.flatnonzero(label == value) for value in np.unique(label)]
    groups = []
    while pending:
        group = pending.pop()
        if len(group) > 2:
            cost, parts = _split(group, low[group], high[group])
            whole = _growing_surface(low[group], high[group])[-1] * len(group)
            if len(group) > CLUSTER_TRIANGLES or cost < WORTHWHILE * whole:
                pending += parts
                continue
        if len(group):
            groups.append(group)
    return groups


def _split(group: np.ndarray, low: np.ndarray, high: np.ndarray
           ) -> tuple[float, list[np.ndarray]]:
    """Cut a group in two so that the boxes of both are small for the triangles in them.

    Tried along the position and the size of the triangles' boxes, at every place; the cost is
    the usual one of ray tracing, surface times number.
    """
    best, parts = np.inf, [group]
    keys = np.concatenate([low + high, high - low], axis=1)
    count = np.arange(1, len(group))
    for key in keys.T:
        order = np.argsort(key, kind="stable")
        ahead = _growing_surface(low[order], high[order])[:-1]
        behind = _growing_surface(low[order[::-1]], high[order[::-1]])[-2::-1]
        cost = ahead * count + behind * count[::-1]
        at = int(cost.argmin())
        if cost[at] < best:
            best, parts = cost[at], [group[order[:at + 1]], group[order[at + 1:]]]
    return best, parts


def _growing_surface(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Surface of the box around the first 1, 2, ... boxes."""
    size = np.maximum.accumulate(high) - np.minimum.accumulate(low)
    return size[:, 0] * size[:, 1] + size[:, 1] * size[:, 2] + size[:, 2] * size[:, 0]


def _pieces(corners: np.ndarray) -> np.ndarray:
    """(T,) number of the connected piece of each triangle; small pieces share number 0."""
    points = corners.reshape(-1, 3)
    size = max(float(np.ptp(points, axis=0).max()), 1e-12)
    _, vertex = np.unique(np.round(points / (size * 1e-6)).astype(np.int64), axis=0,
                          return_inverse=True)
    triangles = vertex.reshape(-1, 3)
    label = np.arange(triangles.max() + 1)
    while True:  # the lowest label spreads over a piece, by leaps
        lowest = label[triangles].min(axis=1)
        new = label.copy()
        for corner in triangles.T:
            np.minimum.at(new, corner, lowest)
        new = new[new]
        if (new == label).all():
            break
        label = new
    _, piece = np.unique(label[triangles[:, 0]], return_inverse=True)
    count = piece.max() + 1
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, piece, corners.min(axis=1))
    np.maximum.at(high, piece, corners.max(axis=1))
    large = (high - low).max(axis=1) > SMALL_PIECE * size
    return np.where(large, np.arange(1, count + 1), 0)[piece]


def _box(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    return (low + high) / 2, (high - low) / 2


def _facing(corners: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """(7,) low and high of the unit normals n of triangles (T, 3, 3), low of n . (x - centre).

    An eye at e sees the front of none of them if the highest n . (e - centre) that these allow is
    no more than the low: one test for the whole cluster.
    """
    normal = normalised(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    offset = (normal * (corners[:, 0] - centre)).sum(axis=1)
    return np.array([*normal.min(axis=0), *normal.max(axis=0), offset.min()])
