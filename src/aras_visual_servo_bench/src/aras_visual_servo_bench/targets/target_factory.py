"""Make targets from the name of a shape, an image, an outline in an SVG file, or a mesh."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import fields
from functools import lru_cache
from pathlib import Path
from typing import Any

from aras_visual_servo_base.names import USER_FAULTS, format_error, suggest
from aras_visual_servo_controller.parameters import MODEL_TRACKER, OUTLINE_TRACKER

from ..errors import ExperimentError, require
from .geometry import DEFAULT_SIZE, PolygonTarget, Target
from .shapes import SHAPES, TargetShape

Corners = tuple[tuple[float, float], ...]
MESHES = (".stl", ".obj", ".dae", ".glb", ".gltf")
CLASS_PATH = re.compile(r"[\w.]+:\w+")  # 'package.module:Class'


def find_shape(shape: str | Corners) -> type[TargetShape] | None:
    """Return the class of a shape that is given by its name or as 'package.module:Class'.

    Return None for the path of a file, for corners and for an unknown name.

    Raises:
        ExperimentError: the class 'package.module:Class' does not exist.
    """
    if not isinstance(shape, str):
        return None
    return SHAPES.find(shape) if CLASS_PATH.fullmatch(shape) else SHAPES.get(shape)


def is_mesh(shape: str | Corners) -> bool:
    """Return True if the shape of a target is the path of a mesh file."""
    return isinstance(shape, str) and Path(shape).suffix.lower() in MESHES


def is_solid(shape: str | Corners) -> bool:
    """Return True if the shape of a target is a mesh file or the name of a solid."""
    return is_mesh(shape) or getattr(find_shape(shape), "is_solid", False)


def find_tracker(shape: str | Corners) -> str:
    """Return the name of the tracker that detects the points of a target."""
    if is_mesh(shape):
        return MODEL_TRACKER
    found = find_shape(shape)
    if found is None and isinstance(shape, str):
        # An image file whose name is that of a flat shape shows this shape, for example
        # four_dots.png.
        found = SHAPES.get(Path(shape).stem)
        found = None if found is None or found.is_solid else found
    return OUTLINE_TRACKER if found is None else found.tracker


def list_parameters(shape: str | Corners) -> frozenset[str]:
    """Return the names of the parameters of a named shape; a file or corners have none."""
    found = find_shape(shape)
    return frozenset(() if found is None else (field.name for field in fields(found)))


def find_default_size(shape: str) -> tuple[float, ...] | None:
    """Return a shape's default size (m) for command-line programs; None if a file gives the size.
    """
    if is_mesh(shape) or Path(shape).suffix.lower() == ".svg":
        return None
    return (0.1, 0.1, 0.1) if is_solid(shape) else (0.1, 0.1)


@lru_cache(maxsize=4)  # the cache is small, because images and meshes are large
def make_target(
    shape: str | Corners,
    size: tuple[float, ...] | None = None,
    scale: float | None = None,
    marker: str = "",
) -> Target:
    """Make a target from the name of a shape, the path of a file, or the corners of a polygon.

    Args:
        shape, size, scale: settings of the target; see TargetSpec.
        marker: marker to draw, for a shape that has this parameter.

    Raises:
        ExperimentError: there is no shape with this name, or the file cannot be used.
    """
    if not isinstance(shape, str):
        return PolygonTarget(shape)
    require(
        scale is None or is_mesh(shape),
        f"target.scale applies only to meshes, but '{shape}' is not a mesh: set target.size",
    )
    if find_shape(shape) is not None:
        return _make_shape(shape, {"size": size and list(size), "marker": marker})
    path = Path(shape).expanduser()
    if is_mesh(shape):
        from .solids import read_solid_target

        return read_solid_target(path, size, scale)
    require(
        size is None or len(size) == 2,
        f"target.size of {shape} is {list(size or ())}, must be two lengths, along x and y, m",
    )
    if not path.suffix:
        raise ExperimentError(f"target.shape is '{shape}': {suggest(shape, SHAPES)}")
    require(path.is_file(), f"target.shape: there is no file {path}")
    if path.suffix.lower() == ".svg":
        from .svg_outlines import read_svg

        return PolygonTarget(read_svg(path).scale_to_page(size))
    from .textures import read_image_target

    return read_image_target(path, size or DEFAULT_SIZE)


def _make_shape(name: str, parameters: Mapping[str, Any]) -> Target:
    """Make the target of a named shape; parameters that the shape does not have are ignored."""
    known = list_parameters(name)
    shape = SHAPES.create(name, **{k: v for k, v in parameters.items() if v and k in known})
    try:
        target = shape.make()
    except ExperimentError:
        raise
    except USER_FAULTS as error:
        raise ExperimentError(
            f"target shape '{name}': its method make raised {format_error(error)}"
        ) from error
    require(isinstance(target, Target),
            f"target shape '{name}': its method make returned {type(target).__name__}, must return "
            "a Target")
    return target
