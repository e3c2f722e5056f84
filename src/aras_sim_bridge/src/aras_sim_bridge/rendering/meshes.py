"""Triangles: the primitive shapes, and STL, OBJ and Collada files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..description.mesh_files import stl_corners
from ..errors import DescriptionError, RenderingError
from .collada import load_collada
from .indexed_mesh import Mesh, from_corners, normalised
from .obj import load_obj


def box(extents: np.ndarray) -> Mesh:
    """Axis-aligned box of full side lengths `extents` (3,), m."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    corners = corners * np.asarray(extents)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    tris = [corners[[q[i] for i in t]] for q in quads for t in ((0, 1, 2), (0, 2, 3))]
    return from_corners(np.array(tris), crease=0.01)


def sphere(radius: float, rings: int = 16, sectors: int = 32) -> Mesh:
    """Sphere of latitude rings and longitude sectors."""
    return _revolve([(radius * np.sin(t), -radius * np.cos(t)) for t in
                     np.linspace(0.0, np.pi, rings + 1)], sectors)


def cylinder(radius: float, length: float, sectors: int = 32) -> Mesh:
    """Cylinder along z, centred."""
    h = length / 2.0
    return _revolve([(0.0, -h), (radius, -h), (radius, h), (0.0, h)], sectors)


def capsule(radius: float, length: float, rings: int = 8, sectors: int = 32) -> Mesh:
    """Capsule along z: a cylinder of `length` with half spheres at its ends."""
    arc = np.linspace(0.0, np.pi / 2, rings + 1)
    low = [(radius * np.sin(t), -length / 2 - radius * np.cos(t)) for t in arc]
    return _revolve(low + [(r, -z) for r, z in reversed(low)], sectors)


def _revolve(profile: list[tuple[float, float]], sectors: int) -> Mesh:
    """Surface of the (radius, z) profile, bottom to top, turned about z."""
    angle = np.linspace(0.0, 2 * np.pi, sectors + 1)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ring[-1] = ring[0]
    tris = []
    for (r0, z0), (r1, z1) in zip(profile, profile[1:], strict=False):
        for a, b in zip(ring, ring[1:], strict=False):
            p = [(*(r0 * a), z0), (*(r0 * b), z0), (*(r1 * b), z1), (*(r1 * a), z1)]
            tris += [(p[0], p[1], p[2]), (p[0], p[2], p[3])]
    return from_corners(np.array(tris))


def plane(normal: np.ndarray, half_size: float = 50.0) -> Mesh:
    """Square through the origin; Bullet's planes are endless, Gazebo's ground is 100 m wide."""
    n = normalised(np.asarray(normal, dtype=float))
    u = normalised(np.cross(n, [0.0, 1.0, 0.0] if abs(n[1]) < 0.9 else [1.0, 0.0, 0.0]))
    v = np.cross(n, u)
    p = [half_size * (a * u + b * v) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return from_corners(np.array([[p[0], p[1], p[2]], [p[0], p[2], p[3]]]))


def contains(mesh: Mesh, point: np.ndarray) -> bool:
    """Whether a point (3,) is inside a closed mesh: a ray from it leaves an odd number of times."""
    low, high = mesh.positions.min(axis=0), mesh.positions.max(axis=0)
    if (point < low).any() or (point > high).any():
        return False
    direction = np.array([0.5773, 0.5411, 0.6119])  # along no edge of anything man-made
    a, b, c = mesh.positions[mesh.triangles].astype(float).transpose(1, 0, 2)
    e1, e2, to = b - a, c - a, point - a
    p = np.cross(direction, e2)
    det = (e1 * p).sum(axis=1)
    det = np.where(np.abs(det) > 1e-18, det, np.inf)
    u = (to * p).sum(axis=1) / det
    q = np.cross(to, e1)
    v = q @ direction / det
    t = (e2 * q).sum(axis=1) / det
    hits = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    return bool(np.count_nonzero(hits) % 2)


def load(path: str | Path) -> list[Mesh]:
    """Meshes of a file, one for each material.

    Raises RenderingError that names the file.
    """
    path = Path(path)
    kind = path.suffix.lower()
    readers = {".dae": load_collada, ".obj": load_obj, ".stl": _load_stl}
    if kind not in readers:
        raise RenderingError(
            f"mesh '{path}': '{kind}' files are not read; convert it to one of "
            + ", ".join(sorted(readers))
        )
    try:
        return readers[kind](path)
    except RenderingError as error:
        raise RenderingError(f"mesh '{path}': {error}") from error
    except OSError as error:
        raise RenderingError(f"mesh '{path}' cannot be read: {error.strerror}") from error
    except (ValueError, IndexError, KeyError) as error:
        raise RenderingError(f"mesh '{path}' is damaged: {error}") from error


def _load_stl(path: Path) -> list[Mesh]:
    try:
        return [from_corners(stl_corners(path.read_bytes()))]
    except DescriptionError as error:
        raise RenderingError(f"{error}; export it again") from error
