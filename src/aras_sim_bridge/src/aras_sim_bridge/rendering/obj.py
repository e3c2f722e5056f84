"""Wavefront OBJ files with their MTL colours and textures."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import numpy as np

from ..errors import RenderingError
from .indexed_mesh import Mesh, from_indices


def load_obj(path: Path) -> list[Mesh]:
    """One mesh for each material of the file; normals of the file where every corner has one."""
    positions: list[list[float]] = []
    texcoords: list[list[float]] = []
    normals: list[list[float]] = []
    faces: dict[str, list[list[tuple[int, int, int]]]] = defaultdict(list)
    materials: dict[str, tuple[tuple | None, str | None]] = {}
    current = ""
    for line in path.read_text(errors="replace").splitlines():
        words = line.split()
        if not words:
            continue
        kind, args = words[0], words[1:]
        if kind == "v":
            positions.append([float(a) for a in args[:3]])
        elif kind == "vt":
            texcoords.append([float(a) for a in args[:2]])
        elif kind == "vn":
            normals.append([float(a) for a in args[:3]])
        elif kind == "f":
            corners = [
                _corner(a, len(positions), len(texcoords), len(normals)) for a in args
            ]
            faces[current] += [
                [corners[0], corners[i], corners[i + 1]] for i in range(1, len(corners) - 1)
            ]
        elif kind == "usemtl":
            current = " ".join(args)
        elif kind == "mtllib":
            materials.update(_load_mtl(path.parent / " ".join(args)))
    if not faces:
        raise RenderingError("has no faces")
    v = np.array(positions, dtype=float).reshape(-1, 3)
    if not np.isfinite(v).all():
        raise RenderingError("has vertices that are not finite; export it again")
    vt, vn = np.array(texcoords, dtype=float), np.array(normals, dtype=float)
    meshes = []
    for name, triangles in faces.items():
        index = np.array(triangles)  # (T, 3 corners, 3 of v/vt/vn)
        rgba, texture = materials.get(name, (None, None))
        meshes.append(from_indices(index, v, vt, vn, rgba, texture))
    return meshes


def _corner(word: str, *counts: int) -> tuple[int, int, int]:
    """Zero-based v/vt/vn indices of a corner, -1 where one is missing."""
    parts = (word.split("/") + ["", ""])[:3]
    out = []
    for part, count in zip(parts, counts, strict=True):
        i = int(part) if part else 0
        index = i - 1 if i > 0 else count + i if i < 0 else -1
        if index >= count:
            raise RenderingError(f"face refers to element {i} of {count}")
        out.append(index)
    return tuple(out)


def _load_mtl(path: Path) -> dict[str, tuple[tuple | None, str | None]]:
    """Material name -> (rgba, texture file); a missing MTL file leaves Bullet's colour."""
    materials: dict[str, tuple[tuple | None, str | None]] = {}
    try:
        text = path.read_text(errors="replace")
    except OSError:
        return materials
    name, rgba, texture = "", None, None
    for line in text.splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == "newmtl":
            name, rgba, texture = " ".join(words[1:]), None, None
        elif words[0] == "Kd":
            rgba = (*(float(a) for a in words[1:4]), 1.0)
        elif words[0] == "map_Kd":
            file = path.parent / words[-1]
            texture = str(file) if file.is_file() else None
        materials[name] = (rgba, texture)
    return materials
