"""Mesh files, checked before Bullet gets them.

Bullet's loaders trust what they read: numbers of elements, indices and references that lead
nowhere end the process with a segmentation fault, and an empty file silently leaves a link
without its shape. What passes here Bullet reads to the end.
"""

import os
import tempfile
from dataclasses import replace
from functools import lru_cache
from math import isfinite
from pathlib import Path

import numpy as np

from aras_sim_bridge.description import collada_check
from aras_sim_bridge.description.types import Geometry, RobotDescription
from aras_sim_bridge.errors import DescriptionError

LARGEST_FILE = 256 * 1024 * 1024  # bytes
_LEAST_AREA = 1e-18  # of a parallelogram; cameras leave out what is smaller
_STL_HEAD = 84  # bytes before the triangles of a binary STL file, the last four their number
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("colour", "<u2")])


def with_binary_stl(description: RobotDescription, directory: str) -> RobotDescription:
    """The description with collisions' STL files as Bullet reads them: binary, nothing behind.

    Others are written anew into `directory`; Bullet would silently make no body of them. The files
    have to be sound, see `check_meshes`.
    """
    links = {
        link.name: replace(link, collisions=tuple(
            replace(shape, geometry=_as_binary_stl(shape.geometry, directory))
            for shape in link.collisions
        ))
        for link in description.links.values()
    }
    return replace(description, links=links)


def _as_binary_stl(geometry: Geometry, directory: str) -> Geometry:
    if geometry.kind != "mesh" or Path(geometry.filename).suffix.lower() != ".stl":
        return geometry
    data = Path(geometry.filename).read_bytes()
    corners = stl_corners(data)
    if len(data) == _STL_HEAD + len(corners) * _STL_TRIANGLE.itemsize:
        return geometry
    triangles = np.zeros(len(corners), _STL_TRIANGLE)
    triangles["corners"] = corners
    handle, path = tempfile.mkstemp(suffix=".stl", dir=directory)
    with os.fdopen(handle, "wb") as file:
        file.write(bytes(_STL_HEAD - 4) + len(triangles).to_bytes(4, "little"))
        file.write(triangles.tobytes())
    return replace(geometry, filename=path)


def check_meshes(description: RobotDescription, model: str) -> None:
    """Check every mesh file of a description; `model` is its name for messages.

    Raises:
        DescriptionError: naming model, link and file, what is wrong with it and how to mend it.
    """
    for link in description.links.values():
        for kind, shapes in (("visual", link.visuals), ("collision", link.collisions)):
            for shape in shapes:
                if shape.geometry.kind == "mesh":
                    try:
                        check(shape.geometry.filename, solid=kind == "collision")
                    except DescriptionError as error:
                        raise DescriptionError(
                            f"model '{model}', link '{link.name}', {kind}: {error}"
                        ) from None


def check(path: str, solid: bool = False) -> None:
    """Check one STL, OBJ or COLLADA (.dae) file.

    Args:
        solid: it is to be collided with; Bullet makes no body of some COLLADA files.

    Raises:
        DescriptionError: naming the file, what is wrong with it and how to mend it.
    """
    try:
        state = os.stat(path)
        fault = _fault(path, solid, state.st_mtime_ns, state.st_size)
    except OSError as error:
        fault = f"cannot be read: {error.strerror}"
    if fault:
        raise DescriptionError(f"mesh file {path} {fault}")


@lru_cache(maxsize=256)
def _fault(path: str, solid: bool, _mtime_ns: int, size: int) -> str:
    """What is wrong with a file in this state; '' when nothing is."""
    kind = Path(path).suffix.lower()
    if kind not in _CHECKS:
        return f"is of no kind that is read; convert it to one of {', '.join(sorted(_CHECKS))}"
    if size > LARGEST_FILE:
        return f"has {size} bytes, more than the limit of {LARGEST_FILE}; simplify it"
    try:
        _CHECKS[kind](Path(path).read_bytes(), solid)
    except DescriptionError as error:
        return f"cannot be used: {error}; export it again"
    return ""


def stl_corners(data: bytes) -> np.ndarray:
    """(T, 3, 3) corners of the triangles of an STL file, binary or ASCII, in its own unit.

    Raises:
        DescriptionError: when it is neither, has no triangle, or one that is not finite.
    """
    count = int.from_bytes(data[_STL_HEAD - 4:_STL_HEAD], "little")
    whole = len(data) - _STL_HEAD >= count * _STL_TRIANGLE.itemsize
    if len(data) >= _STL_HEAD and whole and not _is_ascii(data, count):
        corners = np.frombuffer(data, _STL_TRIANGLE, count, _STL_HEAD)["corners"]
    elif data[:5].lower() == b"solid":
        words = [line.split()[1:4] for line in data.splitlines() if line.split()[:1] == [b"vertex"]]
        try:
            corners = np.array(words, dtype=float).reshape(-1, 3, 3)
        except ValueError:
            raise DescriptionError(
                f"its {len(words)} 'vertex' lines are no triangles of three numbers a corner"
            ) from None
    else:
        raise DescriptionError(
            f"its {len(data)} bytes are neither ASCII STL nor a binary one of {count} triangles"
        )
    if not np.isfinite(corners).all():
        raise DescriptionError("a corner is not finite")
    edges = np.diff(corners.astype(float), axis=1)
    if not (np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) > _LEAST_AREA).any():
        raise DescriptionError("it has no triangle with an area")
    return corners


def _is_ascii(data: bytes, count: int) -> bool:
    """Whether a file that is long enough for a binary one is ASCII: some of those begin alike."""
    plain = len(data) == _STL_HEAD + count * _STL_TRIANGLE.itemsize
    return data[:5].lower() == b"solid" and not plain and b"vertex" in data


def _check_stl(data: bytes, _solid: bool) -> None:
    stl_corners(data)


def _check_obj(data: bytes, _solid: bool) -> None:
    counts = {b"v": 0, b"vt": 0, b"vn": 0}
    triangles = 0
    for number, line in enumerate(data.splitlines(), 1):
        kind, *words = line.split() or [b""]
        try:
            if kind == b"v" and not (len(words) >= 3 and all(map(isfinite, map(float, words[:3])))):
                raise DescriptionError("a vertex needs three finite numbers")
            if kind in counts:
                counts[kind] += 1
            elif kind == b"f":
                for word in words:
                    _check_corner(word, tuple(counts.values()))
                triangles += max(len(words) - 2, 0)
        except ValueError:
            raise DescriptionError(f"line {number}: what should be a number is none") from None
        except DescriptionError as error:
            raise DescriptionError(f"line {number}: {error}") from None
    if triangles == 0:
        raise DescriptionError("it has no faces")


def _check_corner(word: bytes, counts: tuple[int, ...]) -> None:
    """A face's corner v/vt/vn: each part counts from 1, or from -1 backwards."""
    for part, count in zip(word.split(b"/"), counts, strict=False):
        index = int(part) if part else None
        if index is not None and not (1 <= index <= count or -count <= index <= -1):
            raise DescriptionError(f"a face refers to element {index} of {count}")


_CHECKS = {".stl": _check_stl, ".obj": _check_obj, ".dae": collada_check.check}
