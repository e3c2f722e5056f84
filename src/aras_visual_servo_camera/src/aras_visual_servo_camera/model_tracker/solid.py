"""A solid for model-based tracking: a closed triangle mesh and its edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aras_visual_servo_base.compiled import jit, jit_inline
from aras_visual_servo_base.meshes import files

from ..errors import TrackingModelError

# Corners of triangles are merged if their distance is smaller than this fraction of the mesh's
# size.
WELD_TOLERANCE = 1e-6
# If the normals of two neighbouring faces differ by less than CREASE_ANGLE, the faces belong to a
# smooth surface, such as that of a cylinder. Their common edge is then visible only where it is on
# the outline of the solid. If the normals differ by less than FLAT_ANGLE, the common edge is never
# visible.
CREASE_ANGLE, FLAT_ANGLE = np.radians(35.0), 1e-4
# A mesh is probably not in metres if its longest side, m, is outside this range.
MIN_SIZE, MAX_SIZE = 2e-3, 5.0
# A motion leaves the surface unchanged if it moves the surface very little along the surface's
# normals: the mean square of this velocity, divided by that of the motion with the largest value,
# must be below this limit.
FREE_MOTION_TOLERANCE = 1e-4
# Triangles are dropped if their area is smaller than this fraction of the square of the mesh's
# size.
MIN_TRIANGLE_AREA = 1e-9


@dataclass(frozen=True, eq=False)
class Solid:
    """A closed triangle mesh with its edges.

    Attributes:
        vertices: (V, 3) vertices in the solid's frame, m.
        faces: (F, 3) indices of the vertices of each face, counter-clockwise when viewed from
            outside.
        normals: (F, 3) outward unit normals of the faces.
        edges: (E, 2) indices of the start and the end of each edge.
        edge_faces: (E, 2) indices of the two faces of each edge. The direction of the edge is
            counter-clockwise around the first face.
        is_crease: (E,) True if the angle between the two faces is large (crease). Any other edge is
            on a smooth surface, and is visible only where it is on the outline of the solid.
        is_outermost: (F,) True if no part of the solid is in front of the plane of the face.
        name: name of the solid, for messages.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    edges: np.ndarray
    edge_faces: np.ndarray
    is_crease: np.ndarray
    is_outermost: np.ndarray
    name: str

    @property
    def size(self) -> float:
        """Longest side of the bounding box, m."""
        return float(np.ptp(self.vertices, axis=0).max())

    @classmethod
    def from_triangles(cls, corners: np.ndarray, name: str = "the model") -> Solid:
        """Build a solid from triangles.

        Args:
            corners: (F, 3, 3) x, y, z of the three corners of each triangle, m.
            name: name of the solid, for messages.

        Raises:
            TrackingModelError: the mesh is probably not in metres, is not closed, or is inside out.
        """
        corners = np.asarray(corners, float)
        if corners.ndim != 3 or corners.shape[1:] != (3, 3) or not np.isfinite(corners).all():
            raise TrackingModelError(
                f"{name}: the corners of the triangles must be finite numbers in an array of shape "
                "(n, 3, 3)"
            )
        size = float(np.ptp(corners.reshape(-1, 3), axis=0).max()) if len(corners) else 0.0
        if size > MAX_SIZE:
            raise TrackingModelError(
                f"{name} is {size:.4g} m long: is it in millimetres? If so, scale it by 0.001, "
                "because meshes must be in metres"
            )
        if size < MIN_SIZE:
            raise TrackingModelError(
                f"{name} is {size:.2g} m long, too small to be visible: scale it to metres"
            )
        vertices, faces = _weld_vertices(corners, WELD_TOLERANCE * size)
        cross = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]],
                         vertices[faces[:, 2]] - vertices[faces[:, 0]])  # fmt: skip
        areas = np.linalg.norm(cross, axis=1)
        is_large = areas > MIN_TRIANGLE_AREA * size * size
        faces, normals = faces[is_large], cross[is_large] / areas[is_large, None]
        edges, edge_faces = _find_edges(faces, name)
        a, b, c = vertices[faces].transpose(1, 0, 2)
        if float((a * np.cross(b, c)).sum()) < 0.0:
            raise TrackingModelError(
                f"{name} is inside out: its triangles are clockwise when viewed from outside; flip "
                "its normals and export it again"
            )
        cosines = (normals[edge_faces[:, 0]] * normals[edge_faces[:, 1]]).sum(axis=1)
        angles = np.arccos(np.clip(cosines, -1.0, 1.0))
        is_visible = angles > FLAT_ANGLE
        return cls(vertices, faces, normals, np.ascontiguousarray(edges[is_visible]),
                   np.ascontiguousarray(edge_faces[is_visible]), angles[is_visible] > CREASE_ANGLE,
                   _find_outermost(vertices, faces, normals, WELD_TOLERANCE * size),
                   name)  # fmt: skip

    def compute_free_motions(self) -> np.ndarray:
        """Compute the motions that leave the surface unchanged.

        An example is the rotation of a cylinder about its axis.

        Returns:
            (6, k), one motion in each column: a translation and a rotation about the middle of the
            bounding box. Rotations are multiplied by `radius`, so all components are lengths. The
            columns are orthonormal.

        Reference: N. Gelfand and L. Guibas, Shape segmentation using local slippage analysis,
        Symposium on Geometry Processing 2004.
        """
        corners = self.vertices[self.faces] - self.middle
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0],
                                       corners[:, 2] - corners[:, 0]), axis=1)  # fmt: skip
        moments = np.cross(corners.mean(axis=1), self.normals) / self.radius
        rows = np.hstack([self.normals, moments]) * np.sqrt(area / area.sum())[:, None]
        values, vectors = np.linalg.eigh(rows.T @ rows)
        return vectors[:, values < FREE_MOTION_TOLERANCE * values[-1]]

    @property
    def middle(self) -> np.ndarray:
        """Middle (3,) of the bounding box, m."""
        return 0.5 * np.sum(self.compute_bounding_box(), axis=0)

    @property
    def radius(self) -> float:
        """Half of the diagonal of the bounding box, m."""
        return 0.5 * float(np.linalg.norm(np.subtract(*self.compute_bounding_box())))

    def compute_section_corners(self) -> np.ndarray:
        """Compute the corners (4, 3), m, of the horizontal rectangle through the solid's middle.

        It is the section of the bounding box at half of its height along z. Control schemes for
        flat targets use this rectangle instead of the solid.
        """
        (x, y, z), (X, Y, Z) = self.compute_bounding_box()
        middle = 0.5 * (z + Z)
        return np.array([(x, y, middle), (X, y, middle), (X, Y, middle), (x, Y, middle)])

    def compute_bounding_box(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the smallest and the largest x, y, z of the vertices, (3,) each, m."""
        return self.vertices.min(axis=0), self.vertices.max(axis=0)


def _weld_vertices(corners: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Merge the equal corners of triangles.

    Args:
        corners: (n, 3, 3) x, y, z of the three corners of each triangle, m.
        tolerance: corners at a smaller distance are merged, m.

    Returns:
        The vertices (V, 3), m, and for each triangle the indices (F, 3) of its vertices. Triangles
        with two equal corners are omitted.
    """
    points = corners.reshape(-1, 3)
    _, first, number = np.unique(
        np.round(points / tolerance).astype(np.int64), axis=0, return_index=True,
        return_inverse=True,
    )  # fmt: skip
    faces = number.reshape(-1, 3)
    different = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return np.ascontiguousarray(points[first]), np.ascontiguousarray(faces[different])


def _find_edges(faces: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the two vertices (E, 2) and the two faces (E, 2) of each edge, as indices."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    face = np.repeat(np.arange(len(faces)), 3)
    forward = start < end
    low, high = np.minimum(start, end), np.maximum(start, end)
    order = np.lexsort((forward, high, low))
    pairs = order.reshape(-1, 2) if len(order) % 2 == 0 else np.zeros((1, 2), int)
    first, second = pairs.T
    closed = (low[first] == low[second]) & (high[first] == high[second])
    if len(order) % 2 or not (closed & (forward[first] != forward[second])).all():
        raise TrackingModelError(
            f"{name} is not a closed surface: each edge needs two triangles of the same "
            "orientation; close its holes, unite its parts, and export it again"
        )
    edges = np.stack([low[first], high[first]], axis=1)
    return edges, np.stack([face[second], face[first]], axis=1)


@jit("f8[:,::1], i8[:,::1], f8[:,::1], f8")
def _find_outermost(vertices, faces, normals, tolerance):
    """Return for each face (F,) whether no part of the solid is in front of its plane."""
    found = np.ones(len(faces), np.bool_)
    for f in range(len(faces)):
        n, p = normals[f], vertices[faces[f, 0]]
        for q in vertices:
            if n[0] * (q[0] - p[0]) + n[1] * (q[1] - p[1]) + n[2] * (q[2] - p[2]) > tolerance:
                found[f] = False
                break
    return found


@jit_inline
def transform_point(a_T_b, point):
    """Return x, y and z in frame a of a point (3,) that is given in frame b."""
    x, y, z = point
    return (
        a_T_b[0, 0] * x + a_T_b[0, 1] * y + a_T_b[0, 2] * z + a_T_b[0, 3],
        a_T_b[1, 0] * x + a_T_b[1, 1] * y + a_T_b[1, 2] * z + a_T_b[1, 3],
        a_T_b[2, 0] * x + a_T_b[2, 1] * y + a_T_b[2, 2] * z + a_T_b[2, 3],
    )


def read_triangles(meshes: Sequence) -> np.ndarray:
    """Return the corners (F, 3, 3), m, of all triangles of meshes.

    A mesh has the attributes `positions` (its vertices) and `triangles` (indices of vertices).
    """
    return np.concatenate([np.asarray(m.positions, float)[m.triangles] for m in meshes])


def read_solid(path: str, scale: float = 1.0) -> Solid:
    """Read a solid from a mesh file.

    Args:
        path: mesh file.
        scale: factor on the lengths of the file, e.g. 0.001 if they are in mm.

    Raises:
        DescriptionError: the file cannot be read.
        TrackingModelError: the mesh is not closed, or is probably not in metres.
    """
    try:
        return Solid.from_triangles(scale * read_triangles(files.read(path)), Path(path).name)
    except TrackingModelError as error:
        key = " (model_scale)" if "scale it" in str(error) else ""
        raise TrackingModelError(f"{path}: {error}{key}") from None
