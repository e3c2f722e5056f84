"""Drawing of a model: its faces, and the edges between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from aras_sim_bridge.description import parse_urdf
from aras_sim_bridge.description.packages import ResolvePackage, find_package
from aras_visual_servo_base.meshes.mesh import Mesh

from .drawing_shapes import FACES, LINES, DrawingShape, transform_points
from .robot_visuals import Colour, collect_visuals

# An edge is drawn between two faces if the angle between their normals is at least 30 degrees.
CREASE_COSINE = np.cos(np.radians(30.0))
# colour of edges; lighter than a dark face, so that edges are visible on it
EDGE_COLOUR = (0.55, 0.58, 0.64, 1.0)
EDGE_WIDTH = 0.001  # m
# largest number of drawn edges, and of drawn triangles of each colour
MAX_ELEMENTS = 2000


@dataclass(frozen=True, eq=False)
class ModelDrawing:
    """Edges and faces of a model's root link.

    All points are in the frame of this link, m.

    Attributes:
        edges: array (2 * n, 3), both ends of each of n edges.
        faces: for each colour, an array (3 * m, 3), the three corners of each of its m triangles.
    """

    edges: np.ndarray
    faces: Mapping[Colour, np.ndarray]

    def make_shapes(self, base_T_link: np.ndarray | None) -> tuple[DrawingShape, ...]:
        """Return the shapes of a target whose link has the pose base_T_link (4, 4).

        If the pose is None, return a single shape without points, which draws nothing.
        """
        if base_T_link is None:
            return (DrawingShape("target", LINES, EMPTY_DRAWING.edges, EDGE_COLOUR, EDGE_WIDTH),)
        return (
            DrawingShape("target", LINES, transform_points(base_T_link, self.edges), EDGE_COLOUR,
                EDGE_WIDTH),
            *(DrawingShape(f"target face {k}", FACES, transform_points(base_T_link, corners),
                           colour)
              for k, (colour, corners) in enumerate(self.faces.items())),
        )  # fmt: skip


EMPTY_DRAWING = ModelDrawing(np.empty((0, 3)), {})


def draw_model(urdf: str, resolve: ResolvePackage = find_package) -> ModelDrawing:
    """Return the edges and faces of the visuals of a model's root link.

    Args:
        urdf: description of the model.
        resolve: finds the folder of a ROS package.

    Raises:
        DescriptionError: the description, or one of its meshes, cannot be used.
    """
    robot = parse_urdf(urdf, resolve)
    edges, faces = [EMPTY_DRAWING.edges], {}
    for link, colour, mesh in collect_visuals(robot, urdf):
        if link == robot.root:
            edges.append(find_mesh_edges(mesh))
            faces.setdefault(colour, []).append(mesh.positions[mesh.triangles.ravel()])
    return ModelDrawing(
        np.concatenate(edges)[: 2 * MAX_ELEMENTS],
        {colour: np.concatenate(found)[: 3 * MAX_ELEMENTS] for colour, found in faces.items()},
    )


def find_mesh_edges(mesh: Mesh) -> np.ndarray:
    """Return the ends (2 * n, 3) of the n edges that are drawn for a mesh.

    An edge is drawn if it is at the border of the surface, or if the normals of its two faces
    differ by at least 30 degrees.
    """
    places, number = np.unique(mesh.positions.round(6), axis=0, return_inverse=True)
    corners = number.ravel()[mesh.triangles]
    a, b, c = (places[corners[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    edge_normals: dict[tuple[int, int], list[np.ndarray]] = {}
    for triangle, normal in zip(corners.tolist(), normals, strict=True):
        for k in range(3):
            edge_normals.setdefault(tuple(sorted((triangle[k - 1], triangle[k]))), []).append(
                normal
            )
    ends = [
        pair for pair, faces in edge_normals.items()
        if pair[0] != pair[1] and (len(faces) != 2 or float(faces[0] @ faces[1]) < CREASE_COSINE)
    ]  # fmt: skip
    return places[np.array(ends, int).reshape(-1)].reshape(-1, 3)
