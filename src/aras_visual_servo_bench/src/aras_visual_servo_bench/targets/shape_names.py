"""Names of shapes that are more than an outline: solids, and rectangles with an image."""

from __future__ import annotations

from pathlib import Path

PRIMITIVES = ("box", "cylinder", "sphere")
PICTURES = ("four_dots", "marker", "line_grid", "poster")
MESHES = (".stl", ".obj", ".dae", ".glb", ".gltf")


def is_mesh(shape: str | tuple) -> bool:
    """Whether a target's shape is the path of a mesh file."""
    return isinstance(shape, str) and Path(shape).suffix.lower() in MESHES


def is_solid(shape: str | tuple) -> bool:
    """Whether a target's shape is the path of a mesh file, or a primitive's name."""
    return is_mesh(shape) or isinstance(shape, str) and shape in PRIMITIVES
