"""A model as lines: the edges of what its description shows."""

from __future__ import annotations

import numpy as np

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.description.mesh import Mesh
from aras_sim_bridge.description.packages import ResolvePackage, find
from aras_sim_bridge.description.shapes import triangles
from aras_visual_servo_controller.arm.poses import transform

CREASE = np.cos(np.radians(30.0))  # of the angle between faces from which their edge is drawn
MOST = 2000  # edges; a model of more is no target


def edges_of(urdf: str, resolve: ResolvePackage = find) -> np.ndarray:
    """Ends (2 n, 3) of the edges of a model's first link, m, in that link; pairs belong together.

    Raises:
        DescriptionError: the description, or one of its meshes, cannot be used.
    """
    robot = parse_urdf(urdf, resolve)
    found = [np.zeros((0, 3))]
    for visual in robot.links[robot.root].visuals:
        placed = transform(visual.origin_xyz, visual.origin_rpy)
        found += [mesh_edges(mesh.transformed(placed)) for mesh in triangles(visual.geometry)]
    return np.concatenate(found)[: 2 * MOST]


def mesh_edges(mesh: Mesh) -> np.ndarray:
    """Ends (2 n, 3) of the edges at which a surface ends or bends."""
    places, number = np.unique(mesh.positions.round(6), axis=0, return_inverse=True)
    corners = number.ravel()[mesh.triangles]
    a, b, c = (places[corners[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    beside: dict[tuple[int, int], list[np.ndarray]] = {}
    for triangle, normal in zip(corners.tolist(), normals, strict=True):
        for k in range(3):
            beside.setdefault(tuple(sorted((triangle[k - 1], triangle[k]))), []).append(normal)
    ends = [
        pair for pair, faces in beside.items()
        if pair[0] != pair[1] and (len(faces) != 2 or float(faces[0] @ faces[1]) < CREASE)
    ]  # fmt: skip
    return places[np.array(ends, int).reshape(-1)].reshape(-1, 3)
