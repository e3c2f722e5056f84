"""Readers of STL, OBJ, COLLADA and glTF files, which check and cache them.

Invalid files are rejected, for example if a face refers to a missing vertex, if a number cannot be
parsed, or if there are no triangles. A library that silently repairs such errors could render or
simulate another shape than intended. Therefore STL and OBJ files are parsed here, and not by
trimesh: trimesh 5.2 accepts some invalid OBJ files and misreads negative indices, and its import
takes 0.6 s.
"""

from __future__ import annotations

import logging
import math
import os
import stat
import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import DescriptionError
from ..safe_xml import shorten
from ..urdf import Rgba
from .mesh import GREY, Mesh, check_size, find_texture, from_corners, from_indices

LARGEST_FILE = 256 * 1024 * 1024  # largest size of a mesh file, bytes
_log = logging.getLogger(__name__)
_LARGEST_CACHE = 256 * 1024 * 1024  # largest total size of the cached mesh arrays, bytes
# Number of bytes before the triangles in a binary STL file, of which the last four are the number
# of triangles.
_STL_HEADER = 84
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("colour", "<u2")])

_State = tuple[int, int]  # size of a mesh file (bytes), and time of its last change (ns)
_cache: OrderedDict[str, tuple[dict[Path, _State | None], tuple[Mesh, ...]]] = OrderedDict()
_cache_lock = threading.Lock()


def read(path: str) -> tuple[Mesh, ...]:
    """Read the meshes of an STL, OBJ, COLLADA (.dae) or glTF (.glb, .gltf) file.

    There is one mesh for each material and group. The unit of the meshes is m for COLLADA and glTF,
    and the file's own unit for STL and OBJ. As in Gazebo and rviz, axes are not rotated. The result
    is cached until the file changes.

    Raises:
        DescriptionError: the file is invalid; the message names the file, the problem and how to
            fix it.
    """
    with _cache_lock:
        known = _cache.get(path)
        if known is not None and all(_read_state(p) == state for p, state in known[0].items()):
            _cache.move_to_end(path)
            return known[1]
        _cache.pop(path, None)
    file = Path(path)
    reader = _READERS.get(file.suffix.lower())
    if reader is None:
        raise DescriptionError(f"mesh file {path} has an unsupported format",
                               f"convert it to one of {', '.join(sorted(_READERS))}", path)
    states = {file: _read_state(file)}
    try:
        meshes = tuple(reader(_read_contents(file), file.parent, states))
        count = sum(len(mesh.triangles) for mesh in meshes)
        if count == 0:
            raise DescriptionError("the file has no triangles")
        check_size(count)
    except DescriptionError as error:
        raise DescriptionError(f"mesh file {path} cannot be used: {error.fault}",
                               error.remedy or "export it again", path) from None
    with _cache_lock:
        _cache[path] = states, meshes
        while sum(m.nbytes for _, cached in _cache.values() for m in cached) > _LARGEST_CACHE:
            _cache.popitem(last=False)
    return meshes


def _read_state(path: Path) -> _State | None:
    try:
        state = os.stat(path)
    except OSError:
        return None
    return state.st_size, state.st_mtime_ns


def _read_contents(path: Path) -> bytes:
    """Return the content of a regular file of at most LARGEST_FILE bytes.

    Other files, such as devices, are rejected, because reading them might never end.
    """
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(handle, "rb") as file:
            state = os.fstat(handle)
            if not stat.S_ISREG(state.st_mode):
                raise DescriptionError("it is not a regular file")
            if state.st_size > LARGEST_FILE:
                raise DescriptionError(
                    f"the file has {state.st_size} bytes, more than the limit of {LARGEST_FILE}",
                    "simplify it")
            return file.read(LARGEST_FILE)
    except OSError as error:
        raise DescriptionError(f"the file cannot be read: {error.strerror}") from None


# ---------------------------------------------------------------------- STL

def _read_stl(data: bytes, _folder: Path, _states: dict[Path, _State | None]) -> list[Mesh]:
    count = int.from_bytes(data[_STL_HEADER - 4:_STL_HEADER], "little")
    whole = len(data) - _STL_HEADER >= count * _STL_TRIANGLE.itemsize
    if len(data) >= _STL_HEADER and whole and not _is_ascii(data, count):
        check_size(count)
        corners = np.frombuffer(data, _STL_TRIANGLE, count, _STL_HEADER)["corners"]
    elif data[:5].lower() == b"solid":
        words = [line.split()[1:4] for line in data.splitlines() if line.split()[:1] == [b"vertex"]]
        check_size(len(words) // 3)
        try:
            corners = np.array(words, dtype=float).reshape(-1, 3, 3)
        except ValueError:
            raise DescriptionError(
                f"the file's {len(words)} 'vertex' lines do not form triangles with three numbers "
                "per corner"
            ) from None
    else:
        raise DescriptionError(
            f"the file's {len(data)} bytes are neither an ASCII STL file nor a binary STL file of "
            f"{count} triangles"
        )
    return [from_corners(corners)]


def _is_ascii(data: bytes, count: int) -> bool:
    """Return whether the content of an STL file is text (ASCII) and not binary.

    An ASCII file starts with "solid", but a binary file may also do so. A file is ASCII if it also
    contains the word "vertex" and does not have the length of a binary file with `count` triangles.
    """
    plain = len(data) == _STL_HEADER + count * _STL_TRIANGLE.itemsize
    return data[:5].lower() == b"solid" and not plain and b"vertex" in data


def write_stl(meshes: tuple[Mesh, ...], path: str) -> None:
    """Write the triangles of meshes to a binary STL file.

    The file ends after the last triangle. Bullet would not read a file with more bytes.
    """
    corners = np.concatenate([mesh.positions[mesh.triangles] for mesh in meshes])
    triangles = np.zeros(len(corners), _STL_TRIANGLE)
    triangles["corners"] = corners
    with open(path, "wb") as file:
        file.write(bytes(_STL_HEADER - 4) + len(triangles).to_bytes(4, "little"))
        file.write(triangles.tobytes())


# ---------------------------------------------------------------------- OBJ

def write_obj(meshes: tuple[Mesh, ...], path: str) -> None:
    """Write the triangles of meshes to an OBJ file, with one object for each collision body.

    All meshes with the same `Mesh.piece` form one collision body.
    """
    lines, first = [], 1
    for number in sorted({mesh.piece for mesh in meshes}):
        lines.append(f"o piece{number}")
        for mesh in (mesh for mesh in meshes if mesh.piece == number):
            lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.positions.tolist()]
            lines += [f"f {a} {b} {c}" for a, b, c in (mesh.triangles + first).tolist()]
            first += len(mesh.positions)
    Path(path).write_text("\n".join(lines) + "\n", encoding="ascii")


def _read_obj(data: bytes, folder: Path, states: dict[Path, _State | None]) -> list[Mesh]:
    """Read one mesh for each material in each group.

    The normals of the file are used if the file contains a normal for each corner of the mesh.
    """
    elements: dict[str, list[list[float]]] = {"v": [], "vt": [], "vn": []}
    faces: dict[tuple[int, str], list[list[tuple[int, ...]]]] = {}
    materials: dict[str, tuple[Rgba | None, str | None]] = {}
    lacking: set[str] = set()
    material, piece, count = "", 0, 0
    names = {0: ""}  # names of the groups
    for number, line in enumerate(data.decode(errors="replace").splitlines(), 1):
        kind, *words = line.split() or [""]
        try:
            if kind in elements:
                elements[kind].append(_parse_element(kind, words))
            elif kind == "f":
                counts = [len(values) for values in elements.values()]
                corners = [_parse_corner(word, counts) for word in words]
                faces.setdefault((piece, material), []).extend(
                    [corners[0], corners[i], corners[i + 1]] for i in range(1, len(corners) - 1))
                count += max(len(corners) - 2, 0)
            elif kind in ("g", "o"):
                piece += 1
                names[piece] = " ".join(words)
            elif kind == "usemtl":
                material = " ".join(words)
            elif kind == "mtllib":
                library = folder / " ".join(words)
                found = _read_mtl(library, states)
                materials |= found
                lacking |= set() if found else {str(library)}
            check_size(count, len(faces))
        except ValueError:
            raise DescriptionError(f"line {number}: it contains an invalid number") from None
        except DescriptionError as error:
            raise DescriptionError(f"line {number}: {error.fault}", error.remedy) from None
    if count == 0:
        raise DescriptionError("the file has no faces")
    v, vt, vn = (np.array(values, dtype=float).reshape(-1, width)
                 for values, width in zip(elements.values(), (3, 2, 3), strict=True))
    appearances = {name: materials.get(name, (None, None)) for _, name in faces}
    for name in appearances.keys() - materials.keys() - {""}:
        where = (f"the file {min(lacking)} does not exist" if lacking
                 else "no material library of the mesh file defines this material")
        _log.warning("mesh file %s: material '%s' is drawn grey, because %s", next(iter(states)),
                     shorten(name), where)
        appearances[name] = GREY, None
    return [replace(from_indices(np.array(corners), v, vt, vn, *appearances[name], group),
                    name=names[group])
            for (group, name), corners in faces.items() if corners]


def _parse_element(kind: str, fields: list[str]) -> list[float]:
    count = 2 if kind == "vt" else 3
    values = [float(word) for word in fields[:count]]
    if kind == "vt" and len(values) == 1:
        # A vertex of the file may omit the second texture coordinate, which is then 0.
        values.append(0.0)
    if len(values) < count or not all(map(math.isfinite, values)):
        what = {"v": "vertex", "vt": "texture coordinate", "vn": "normal"}[kind]
        raise DescriptionError(f"a {what} needs {'two' if count == 2 else 'three'} finite numbers")
    return values


def _parse_corner(text: str, counts: list[int]) -> tuple[int, ...]:
    """Return the indices v/vt/vn of a corner, which start at 0; -1 for a missing index.

    In the file, indices start at 1, or are negative and count backwards from the last element. Some
    programs write indices of texture coordinates or normals although the file has none of them.
    """
    indices = []
    for what, part in enumerate((text.split("/") + ["", ""])[:3]):
        count = counts[what]
        index = int(part) if part and (count or what == 0) else None
        if index is not None and not (1 <= index <= count or -count <= index <= -1):
            raise DescriptionError(f"a face refers to element {index}, but there are {count} "
                                   "elements")
        indices.append(-1 if index is None else index - 1 if index > 0 else count + index)
    if indices[0] < 0:
        raise DescriptionError("a face has a corner without a vertex")
    return tuple(indices)


def _read_mtl(path: Path, states: dict[Path, _State | None]
              ) -> dict[str, tuple[Rgba | None, str | None]]:
    """Return (rgba, texture file) of each material by name; {} if the MTL file is missing.

    The size and the time of the file's last change are added to `states`.
    """
    materials: dict[str, tuple[Rgba | None, str | None]] = {}
    states[path] = _read_state(path)
    if states[path] is None:
        return materials
    name, rgba, texture, grey = "", None, None, False
    for line in _read_contents(path).decode(errors="replace").splitlines():
        kind, *words = line.split() or [""]
        if kind == "newmtl":
            name, rgba, texture, grey = " ".join(words), None, None, False
        elif kind == "Kd":
            rgba = (*(float(word) for word in words[:3]), 1.0)
            if len(rgba) != 4 or not all(map(math.isfinite, rgba)):
                raise DescriptionError(f"{path.name}: material '{name}': Kd needs three numbers")
        elif kind == "map_Kd" and words:
            # Options such as "-s 1 1 1" may precede the path, which may contain spaces.
            whole = " ".join(words)
            texture = find_texture(path.parent, words[-1] if words[0].startswith("-") else whole,
                                   f"material '{shorten(name)}' of {path}")
            grey = texture is None
        materials[name] = (GREY if grey else rgba, texture)
    return materials


def _read_dae(data: bytes, folder: Path, _states: dict[Path, _State | None]) -> list[Mesh]:
    from . import collada_files  # imported here because pycollada takes 0.07 s and is rarely needed

    return collada_files.read(data, folder)


def _read_gltf(data: bytes, _folder: Path, states: dict[Path, _State | None]) -> list[Mesh]:
    from . import gltf_files

    def find_file(file: Path) -> bytes:
        states[file] = _read_state(file)
        return _read_contents(file)

    return gltf_files.read(data, next(iter(states)), find_file)


_READERS: dict[str, Callable[[bytes, Path, dict[Path, _State | None]], list[Mesh]]] = {
    ".stl": _read_stl, ".obj": _read_obj, ".dae": _read_dae, ".glb": _read_gltf,
    ".gltf": _read_gltf,
}
