"""Triangle meshes of the shapes in a description, for rendering and mesh collisions."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from aras_sim_bridge.description.types import Geometry, RobotDescription, Vector3
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base.meshes import files as mesh_files
from aras_visual_servo_base.meshes.mesh import Mesh, from_corners
from aras_visual_servo_base.poses import quaternion_from_z_to, rotate
from aras_visual_servo_base.safe_xml import shorten

_LARGEST_MESH = 50.0  # size of the largest mesh that causes no warning, m
# Round shapes are approximated by polygons: ARC edges from the pole to the equator of a sphere, and
# SECTORS edges around its axis.
ARC, SECTORS = 8, 32


def make_meshes(geometry: Geometry) -> tuple[Mesh, ...]:
    """Return the triangle meshes of a shape in its own frame, m; a mesh file may contain several.

    Raises:
        DescriptionError: the mesh file cannot be used.
    """
    if geometry.kind == "mesh":
        scale = np.array(geometry.scale)
        return tuple(part.transform(np.eye(4), scale) for part in read_mesh(geometry))
    return _make_mesh(geometry.kind, tuple(geometry.size), geometry.radius, geometry.length,
                 tuple(geometry.normal))


def read_mesh(geometry: Geometry) -> tuple[Mesh, ...]:
    """Read the mesh file of a shape, or the submesh that the shape uses, in the unit of the file.

    Raises:
        DescriptionError: the mesh file cannot be used, or it does not contain the submesh.
    """
    meshes = mesh_files.read(geometry.filename)
    if not geometry.submesh:
        return meshes
    parts = tuple(mesh for mesh in meshes if mesh.name == geometry.submesh)
    if not parts:
        known = ", ".join(dict.fromkeys(mesh.name for mesh in meshes if mesh.name)) or "none"
        raise DescriptionError(
            f"mesh file {geometry.filename} has no submesh '{shorten(geometry.submesh)}'; its "
            f"submeshes are: {shorten(known, 200)}", path=geometry.filename)
    if not geometry.is_centred:
        return parts
    corners = np.concatenate([mesh.positions for mesh in parts]).astype(float)
    shift = np.eye(4)
    shift[:3, 3] = -0.5 * (corners.min(axis=0) + corners.max(axis=0))
    return tuple(mesh.transform(shift) for mesh in parts)


@lru_cache(maxsize=32)  # keep at most 32 meshes, because a sphere needs 150 kB of memory
def _make_mesh(kind: str, size: Vector3, radius: float, length: float, normal: Vector3
          ) -> tuple[Mesh, ...]:
    """Return the mesh of a geometric primitive. The result is cached; it must not be changed."""
    if kind == "box":
        return (_make_box(np.array(size)),)
    if kind == "plane":
        return (_make_plane(normal, size[:2]),)
    return (_revolve(_make_profile(kind, radius, length)),)


def _make_box(extents: np.ndarray) -> Mesh:
    """Return an axis-aligned box with the side lengths `extents` (3,), m."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    corners = corners * extents
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    tris = [corners[[q[i] for i in t]] for q in quads for t in ((0, 1, 2), (0, 2, 3))]
    return from_corners(np.array(tris))


def _make_profile(kind: str, radius: float, length: float) -> list[tuple[float, float]]:
    """Return the (radius, z) profile of a sphere, cylinder or capsule from bottom to top.

    A capsule is a cylinder of `length` with half spheres at its ends.
    """
    if kind == "sphere":
        return [(radius * np.sin(t), -radius * np.cos(t))
                for t in np.linspace(0.0, np.pi, 2 * ARC + 1)]
    h = length / 2
    if kind == "cylinder":
        return [(0.0, -h), (radius, -h), (radius, h), (0.0, h)]
    low = [(radius * np.sin(t), -h - radius * np.cos(t))
           for t in np.linspace(0.0, np.pi / 2, ARC + 1)]
    return low + [(r, -z) for r, z in reversed(low)]


def _revolve(profile: list[tuple[float, float]]) -> Mesh:
    """Return the surface of revolution about z of a (radius, z) profile from bottom to top."""
    angle = np.linspace(0.0, 2 * np.pi, SECTORS + 1)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ring[-1] = ring[0]
    tris = []
    for (r0, z0), (r1, z1) in zip(profile, profile[1:], strict=False):
        for a, b in zip(ring, ring[1:], strict=False):
            p = [(*(r0 * a), z0), (*(r0 * b), z0), (*(r1 * b), z1), (*(r1 * a), z1)]
            tris += [(p[0], p[1], p[2]), (p[0], p[2], p[3])]
    return from_corners(np.array(tris))


def _make_plane(normal: Vector3, size: tuple[float, float]) -> Mesh:
    """Return a rectangle around the origin; a side of 0 m becomes 100 m, like Gazebo's ground."""
    tilt = quaternion_from_z_to(normal)
    wide, deep = (0.5 * (side or 100.0) for side in size)
    corners = np.array([rotate(tilt, (a * wide, b * deep, 0.0))
                        for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    return from_corners(corners[[[0, 1, 2], [0, 2, 3]]])


def read_mesh_files(description: RobotDescription, model: str) -> list[str]:
    """Read every mesh file of a description; `model` is its name in messages.

    Returns:
        A sentence for each file that is probably in millimetres: the model is not static, and a
        mesh in the file is larger than 50 m and has no scale.

    Raises:
        DescriptionError: a mesh file is invalid; the message names model, link and file, the
            problem and how to fix it.
    """
    huge: dict[str, str] = {}
    for link, kind, geometry in _list_mesh_geometries(description):
        where, file = f"model '{model}', link '{link}', {kind}", geometry.filename
        try:
            meshes = read_mesh(geometry)
        except DescriptionError as error:
            raise DescriptionError(f"{where}: {error.fault}", error.remedy, error.path) from None
        size = max((float(np.ptp(mesh.positions, axis=0).max())
                    for mesh in meshes if len(mesh.positions)), default=0.0)
        if size > _LARGEST_MESH and not description.static and geometry.scale == (1.0, 1.0, 1.0):
            huge[file] = (f"{where}: {file} is {size:.4g} m large; if it is in millimetres, give "
                          "its <mesh> the scale 0.001 0.001 0.001")
    return list(huge.values())


def _list_mesh_geometries(description: RobotDescription) -> Iterator[tuple[str, str, Geometry]]:
    """Yield link, kind (visual or collision) and geometry of each shape with a mesh file."""
    for link in description.links.values():
        for kind, shapes in (("visual", link.visuals), ("collision", link.collisions)):
            yield from ((link.name, kind, shape.geometry) for shape in shapes
                        if shape.geometry.kind == "mesh")
