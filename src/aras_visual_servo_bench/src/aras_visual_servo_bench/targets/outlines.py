"""Targets by name: outlines, made pictures, a PNG, an SVG outline, a mesh."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element

import numpy as np

from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.names import nearest
from aras_visual_servo_controller.settings import MODEL, OUTLINE

from ..errors import ExperimentError, require
from .geometry import ARAS, PolygonTarget, RoundTarget, Target
from .solids import PRIMITIVES, is_solid, primitive, solid_target
from .textures import MADE, from_picture

if TYPE_CHECKING:
    from svgelements import Shape

CIRCLE_EDGES = 180
LARGEST_SVG = 1_000_000  # bytes
MOST_ELEMENTS = 10_000  # of an SVG, with the copies that <use> makes
SAMPLES = 24  # of each curve of an SVG path


def _ring(count: int, turn: float = 0.0) -> tuple[tuple[float, float], ...]:
    around = turn + 2.0 * np.pi * np.arange(count) / count
    return tuple(zip((0.5 * np.cos(around)).tolist(), (0.5 * np.sin(around)).tolist(), strict=True))


# Corners within a square of side 1; the size of the target scales them.
OUTLINES: dict[str, tuple[tuple[float, float], ...]] = {
    "square": ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)),
    "triangle": ((-0.5, -0.4), (0.5, -0.3), (-0.1, 0.5)),
    "l_shape": ((-0.5, -0.5), (0.5, -0.5), (0.5, -0.1), (-0.1, -0.1), (-0.1, 0.5), (-0.5, 0.5)),
    "heptagon": _ring(7),
}
NAMES = ("aras", "circle", *OUTLINES, *MADE, *PRIMITIVES)
# What finds the points of those that are more than an outline.
TRACKERS = {"four_dots": "dots", "marker": "marker", "line_grid": "lines"}


def tracker_of(shape: str | tuple[tuple[float, float], ...]) -> str:
    """Name of the tracker of a target's points, by its shape as in TargetSpec or by its file."""
    if is_solid(shape):
        return MODEL
    return TRACKERS.get(Path(shape).stem, OUTLINE) if isinstance(shape, str) else OUTLINE


@lru_cache(maxsize=4)  # pictures and meshes are large
def shape_of(
    shape: str | tuple[tuple[float, float], ...], size: tuple[float, ...]
) -> Target:
    """The target of a name, of a picture's, an SVG's or a mesh's path, or of a flat polygon's
    corners.

    Args:
        shape: as in TargetSpec.
        size: of what has a name, or a picture's or an SVG's path, along x and y, of a box, a
            cylinder or a sphere also along z, m.

    Raises:
        ExperimentError: there is none of that name, or its file cannot be used.
    """
    if not isinstance(shape, str):
        return PolygonTarget(shape)
    if shape == "aras":
        return ARAS
    if shape in PRIMITIVES:
        return primitive(shape, size)
    require(
        len(size) == 2 or is_solid(shape),
        f"target.size of {shape} is {list(size)}, must be two lengths, along x and y, m",
    )
    if shape == "circle":
        return RoundTarget(_scaled(_ring(CIRCLE_EDGES), size))
    if shape in OUTLINES:
        return PolygonTarget(_scaled(OUTLINES[shape], size))
    if shape in MADE:
        return MADE[shape](size)
    path = Path(shape).expanduser()
    require(bool(path.suffix), f"target.shape is '{shape}': {nearest(shape, NAMES)}")
    if is_solid(shape):
        return solid_target(path)
    require(path.is_file(), f"target.shape: there is no file {path}")
    if path.suffix.lower() == ".svg":
        return PolygonTarget(_scaled(svg_outline(path), size))
    return from_picture(path, size)


def _scaled(
    corners: tuple[tuple[float, float], ...], size: tuple[float, float]
) -> tuple[tuple[float, float], ...]:
    return tuple((x * size[0], y * size[1]) for x, y in corners)


# -- SVG ---------------------------------------------------------------------------------------


def svg_outline(path: Path) -> tuple[tuple[float, float], ...]:
    """Corners of the one outline in an SVG file, fitted into a square of side 1 about 0.

    Understood are polygon, polyline, rect, circle, ellipse and path, where their transforms put
    them. A curve becomes SAMPLES edges, an arc CIRCLE_EDGES a turn.

    Raises:
        ExperimentError: it is no SVG, holds entities or too many copies, or none or several
            outlines.
    """
    from svgelements import SVG, Shape

    where = f"target.shape: {path}"
    require(path.stat().st_size <= LARGEST_SVG, f"{where} is larger than {LARGEST_SVG} bytes")
    try:
        text = path.read_text(encoding="utf-8")
        count = _count_drawn(safe_xml.parse(text, f"{where} is no SVG", doctype=True))
        require(
            count <= MOST_ELEMENTS,
            f"{where} draws more than {MOST_ELEMENTS} elements, copies by <use> counted: draw the "
            "outline once, as one path",
        )
        drawing = SVG.parse(io.StringIO(text), reify=False, on_error="raise")
        require(isinstance(drawing, SVG), f"{where} is no SVG: its root is not <svg>")
        shapes = [element for element in drawing.elements() if isinstance(element, Shape)]
        found = [corners for shape in shapes for corners in _outlines(shape)]
    except DescriptionError as error:
        raise ExperimentError(str(error)) from None
    except (ValueError, TypeError, ArithmeticError, RecursionError) as error:
        why = str(error) or "numbers are missing"
        raise ExperimentError(f"{where} has a wrong outline: {why}") from None
    require(
        bool(found),
        f"{where} holds no outline: a polygon, rect, circle, ellipse or closed path",
    )
    require(
        len(found) == 1,
        f"{where} holds {len(found)} outlines, and a target has one: leave one in the file",
    )
    points = found[0]
    low, high = points.min(axis=0), points.max(axis=0)
    require(bool((high > low).all()), f"target.shape: the outline in {path} has no area")
    points = (points - 0.5 * (low + high)) / (high - low).max()
    return tuple((float(x), float(y)) for x, y in points)


def _count_drawn(root: Element) -> int:
    """Elements that are drawn, each copy that <use> makes counted; no further than to the limit."""
    named = {element.get("id"): element for element in root.iter()}
    waiting, count = [root], 0
    while waiting and count <= MOST_ELEMENTS:
        element = waiting.pop()
        count += 1
        waiting.extend(element)
        if element.tag.endswith("use"):
            used = (named.get(value.removeprefix("#")) for name, value in element.items()
                    if name.endswith("href"))  # fmt: skip
            waiting.extend(one for one in used if one is not None)
    return count


def _outlines(shape: Shape) -> Iterator[np.ndarray]:
    """Corners (n, 2), n >= 3, of each part of a shape.

    Raises:
        ValueError: a path that is wrong.
    """
    from svgelements import Arc, Close, Line, Move
    from svgelements import Path as Curve

    unknown = re.search(r"[^MZLHVCSQTAE\d\s,.+-]", str(shape.values.get("d", "")), re.IGNORECASE)
    if unknown:
        raise ValueError(f"path command '{unknown[0]}' is not understood")
    parts: list[list[tuple[float, float]]] = [[]]
    for segment in Curve(shape).segments(transformed=False):
        if isinstance(segment, Move | Close):
            parts.append([])
        count = 1
        if isinstance(segment, Arc):
            count = math.ceil(abs(segment.sweep) / (2.0 * np.pi) * CIRCLE_EDGES)
        elif not isinstance(segment, Move | Close | Line):
            count = SAMPLES
        for k in range(count):
            end = segment.point((k + 1) / count) if count > 1 else segment.end
            parts[-1].append(shape.transform.point_in_matrix_space(end))
    for part in parts:
        corners = np.array([(point.x, point.y) for point in part]).reshape(-1, 2)
        if len(corners) and np.allclose(corners[0], corners[-1]):
            corners = corners[:-1]
        if len(corners) >= 3:
            yield corners
