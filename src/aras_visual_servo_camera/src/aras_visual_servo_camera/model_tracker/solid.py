"""A solid as a tracker needs it: closed triangles, and the edges at which they meet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aras_visual_servo_base.compiled import jit
from aras_visual_servo_base.meshes import files

from ..errors import ModelError

WELD_TOLERANCE = 1e-6  # part of the size within which corners of triangles are one
# Faces that meet at less are one smooth surface (of a cylinder, say): its edges are seen only where
# they are its outline. Below the second they are one flat face, whose edges are never seen.
CREASE_ANGLE, FLAT_ANGLE = np.radians(35.0), 1e-4
MIN_SIZE, MAX_SIZE = 2e-3, 5.0  # m: sizes beyond which a mesh is not in metres
# part of the greatest eigenvalue of the surface's motions, below which it stays
FREE_MOTION_TOLERANCE = 1e-4
MIN_TRIANGLE_AREA = 1e-9  # of the size squared: a triangle with less area is none


@dataclass(frozen=True, eq=False)
class Solid:
    """Attributes:
        vertices: (V, 3) m, in the solid's frame. faces: (F, 3), counter-clockwise from outside.
        normals: (F, 3) unit, outward.
        edges: (E, 2) vertices. beside: (E, 2) the two faces, that first which the
            edge bounds counter-clockwise. creased: (E,) whether it is a crease;
            the others are seen only as outline.
        outermost: (F,) whether nothing of the solid lies before the face's plane.
        name: for messages.
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
        """Greatest side of its box, m."""
        return float(np.ptp(self.vertices, axis=0).max())

    @classmethod
    def from_triangles(cls, corners: np.ndarray, name: str = "the model") -> Solid:
        """A solid of triangles (F, 3, 3), m.

        Raises:
            ModelError: it is not in metres, not closed, or inside out.
        """
        corners = np.asarray(corners, float)
        if corners.ndim != 3 or corners.shape[1:] != (3, 3) or not np.isfinite(corners).all():
            raise ModelError(f"{name}: triangles (n, 3, 3) of finite numbers are needed")
        size = float(np.ptp(corners.reshape(-1, 3), axis=0).max()) if len(corners) else 0.0
        if size > MAX_SIZE:
            raise ModelError(f"{name} is {size:.4g} m long: is it in millimetres? Meshes are in "
                             "metres: scale it by 0.001")  # fmt: skip
        if size < MIN_SIZE:
            raise ModelError(f"{name} is {size:.2g} m long, too small to be seen: scale it to "
                             "metres")  # fmt: skip
        vertices, faces = _weld_vertices(corners, WELD_TOLERANCE * size)
        cross = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]],
                         vertices[faces[:, 2]] - vertices[faces[:, 0]])  # fmt: skip
        area = np.linalg.norm(cross, axis=1)
        solid = area > MIN_TRIANGLE_AREA * size * size
        faces, normals = faces[solid], cross[solid] / area[solid, None]
        edges, beside = _find_edges(faces, name)
        a, b, c = vertices[faces].transpose(1, 0, 2)
        if float((a * np.cross(b, c)).sum()) < 0.0:
            raise ModelError(f"{name} is inside out: its triangles go clockwise seen from outside; "
                             "flip its normals and export it again")  # fmt: skip
        cosine = np.clip((normals[beside[:, 0]] * normals[beside[:, 1]]).sum(axis=1), -1.0, 1.0)
        angle = np.arccos(cosine)
        kept = angle > FLAT_ANGLE
        return cls(vertices, faces, normals, np.ascontiguousarray(edges[kept]),
                   np.ascontiguousarray(beside[kept]), angle[kept] > CREASE_ANGLE,
                   _find_outermost(vertices, faces, normals, WELD_TOLERANCE * size),
                   name)  # fmt: skip

    def compute_free_motions(self) -> np.ndarray:
        """(6, k) motions (m, rad times `radius`) about the middle of its box that leave the surface
        where it is, as turns of a cylinder about its axis; unit columns that are at right angles.

        Reference: N. Gelfand and L. Guibas, Shape segmentation using local slippage analysis,
        Symposium on Geometry Processing 2004.
        """
        corners = self.vertices[self.faces] - self.middle
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0],
                                       corners[:, 2] - corners[:, 0]), axis=1)  # fmt: skip
        turned = np.cross(corners.mean(axis=1), self.normals) / self.radius
        rows = np.hstack([self.normals, turned]) * np.sqrt(area / area.sum())[:, None]
        values, vectors = np.linalg.eigh(rows.T @ rows)
        return vectors[:, values < FREE_MOTION_TOLERANCE * values[-1]]

    @property
    def middle(self) -> np.ndarray:
        """(3,) of its box, m."""
        return 0.5 * np.sum(self.compute_bounding_box(), axis=0)

    @property
    def radius(self) -> float:
        """Half of its box's diagonal, m."""
        return 0.5 * float(np.linalg.norm(np.subtract(*self.compute_bounding_box())))

    def compute_section_corners(self) -> np.ndarray:
        """(4, 3) m, corners of its box's section halfway up its z axis: a plane across the solid,
        as which schemes of flat targets have it."""
        (x, y, z), (X, Y, Z) = self.compute_bounding_box()
        middle = 0.5 * (z + Z)
        return np.array([(x, y, middle), (X, y, middle), (X, Y, middle), (x, Y, middle)])

    def compute_bounding_box(self) -> tuple[np.ndarray, np.ndarray]:
        """Low and high corner (3,) of its box, m."""
        return self.vertices.min(axis=0), self.vertices.max(axis=0)


def _weld_vertices(corners: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) and faces (F, 3) of triangles (F, 3, 3), equal corners being one."""
    points = corners.reshape(-1, 3)
    _, first, number = np.unique(
        np.round(points / tolerance).astype(np.int64), axis=0, return_index=True,
        return_inverse=True,
    )  # fmt: skip
    faces = number.reshape(-1, 3)
    different = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return np.ascontiguousarray(points[first]), np.ascontiguousarray(faces[different])


def _find_edges(faces: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Edges (E, 2) and the faces beside them (E, 2)."""
    begin, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    face = np.repeat(np.arange(len(faces)), 3)
    forward = begin < end
    low, high = np.minimum(begin, end), np.maximum(begin, end)
    order = np.lexsort((forward, high, low))
    pairs = order.reshape(-1, 2) if len(order) % 2 == 0 else np.zeros((1, 2), int)
    one, other = pairs.T
    closed = (low[one] == low[other]) & (high[one] == high[other])
    if len(order) % 2 or not (closed & (forward[one] != forward[other])).all():
        raise ModelError(
            f"{name} is open or folded: each edge needs two triangles that go round alike; close "
            "its holes, unite its parts, and export it again"
        )
    return np.stack([low[one], high[one]], axis=1), np.stack([face[other], face[one]], axis=1)


@jit("f8[:,::1], i8[:,::1], f8[:,::1], f8")
def _find_outermost(vertices, faces, normals, tolerance):
    """See Solid.outermost."""
    found = np.ones(len(faces), np.bool_)
    for f in range(len(faces)):
        n, p = normals[f], vertices[faces[f, 0]]
        for q in vertices:
            if n[0] * (q[0] - p[0]) + n[1] * (q[1] - p[1]) + n[2] * (q[2] - p[2]) > tolerance:
                found[f] = False
                break
    return found


def read_triangles(meshes: Sequence) -> np.ndarray:
    """(F, 3, 3) corners of the meshes of a file (`positions`, `triangles`), m."""
    return np.concatenate([np.asarray(m.positions, float)[m.triangles] for m in meshes])


def read_solid(path: str, scale: float = 1.0) -> Solid:
    """The solid of a mesh file, in m; scale: factor on the file's lengths, 0.001 where it is in mm.

    Raises:
        DescriptionError: the file cannot be read. ModelError: it is not a solid in metres.
    """
    try:
        return Solid.from_triangles(scale * read_triangles(files.read(path)), Path(path).name)
    except ModelError as error:
        key = " (model_scale)" if "scale it" in str(error) else ""
        raise ModelError(f"{path}: {error}{key}") from None
