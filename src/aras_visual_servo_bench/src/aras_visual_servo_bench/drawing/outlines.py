"""A model as a drawing of a few shapes: its faces, and the edges between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.description.packages import ResolvePackage, find
from aras_visual_servo_base.meshes.mesh import Mesh

from .parts import Colour, parts
from .shapes import FACES, LINES, Shape, carried

CREASE = np.cos(np.radians(30.0))  # of the angle between faces from which their edge is drawn
EDGES, EDGE = (0.55, 0.58, 0.64, 1.0), 0.001  # to be told from a dark face; width, m
MOST = 2000  # edges or triangles; a model of more is no target


@dataclass(frozen=True, eq=False)
class Drawing:
    """A model's first link, in m and in that link.

    Attributes:
        edges: (2 n, 3) ends of its edges; pairs belong together.
        faces: of each colour the corners (3 n, 3) of its triangles.
    """

    edges: np.ndarray
    faces: Mapping[Colour, np.ndarray]

    def shapes(self, base_T_link: np.ndarray | None) -> tuple[Shape, ...]:
        """The model as a target, where it lies; of one that is not there, edges without a point."""
        if base_T_link is None:
            return (Shape("target", LINES, NOTHING.edges, EDGES, EDGE),)
        return (
            Shape("target", LINES, carried(base_T_link, self.edges), EDGES, EDGE),
            *(Shape(f"target face {k}", FACES, carried(base_T_link, corners), colour)
              for k, (colour, corners) in enumerate(self.faces.items())),
        )  # fmt: skip


NOTHING = Drawing(np.empty((0, 3)), {})


def drawing_of(urdf: str, resolve: ResolvePackage = find) -> Drawing:
    """Edges and faces of what a model's description shows.

    Raises:
        DescriptionError: the description, or one of its meshes, cannot be used.
    """
    robot = parse_urdf(urdf, resolve)
    edges, faces = [NOTHING.edges], {}
    for link, colour, mesh in parts(robot, urdf):
        if link == robot.root:
            edges.append(mesh_edges(mesh))
            faces.setdefault(colour, []).append(mesh.positions[mesh.triangles.ravel()])
    return Drawing(
        np.concatenate(edges)[: 2 * MOST],
        {colour: np.concatenate(found)[: 3 * MOST] for colour, found in faces.items()},
    )


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
