"""Targets by name, of a PNG, of an SVG outline, of a mesh."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import fields
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree.ElementTree import Element, tostring

import numpy as np

from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.names import USER_FAULTS, format_error, suggest
from aras_visual_servo_controller.parameters import MODEL_TRACKER, OUTLINE_TRACKER

from ..errors import ExperimentError, require
from .geometry import IMAGE_FLIP, PolygonTarget, Target
from .shapes import SHAPES, TargetShape

if TYPE_CHECKING:
    from svgelements import Shape

Corners = tuple[tuple[float, float], ...]
DEFAULT_SIZE = (0.2, 0.2)  # m, of a target that has no size of its own
CIRCLE_EDGES = 180  # a turn of an SVG's arc
MESHES = (".stl", ".obj", ".dae", ".glb", ".gltf")
CLASS_PATH = re.compile(r"[\w.]+:\w+")  # a class of a user's own
MAX_SVG_BYTES = 1_000_000  # bytes
UNITS = ("", "mm", "cm", "in", "pt", "pc", "px")  # of lengths of an SVG's page
PPI = 96.0  # px in an inch, by CSS
MAX_ELEMENTS = 10_000  # of an SVG, with the copies that <use> makes
SAMPLES = 24  # of each curve of an SVG path
ASPECT_TOLERANCE = 0.01  # how far a page's may be from its viewBox's: files are rounded
MAX_CORNER_DISTANCE = 100.0  # pages from the page's middle to a corner


def find_shape(shape: str | Corners) -> type[TargetShape] | None:
    """The class of a named shape or of 'package.module:Class'; None: a file, corners, no name.

    Raises:
        ExperimentError: there is no such class.
    """
    if not isinstance(shape, str):
        return None
    return SHAPES.find(shape) if CLASS_PATH.fullmatch(shape) else SHAPES.get(shape)


def is_mesh(shape: str | Corners) -> bool:
    """Whether a target's shape is the path of a mesh file."""
    return isinstance(shape, str) and Path(shape).suffix.lower() in MESHES


def is_solid(shape: str | Corners) -> bool:
    """Whether a target's shape is a mesh file, or a solid by name."""
    return is_mesh(shape) or getattr(find_shape(shape), "is_solid", False)


def find_tracker(shape: str | Corners) -> str:
    """Name of the tracker of a target's points, by its shape as in TargetSpec or by its file."""
    if is_mesh(shape):
        return MODEL_TRACKER
    named = find_shape(shape)
    if named is None and isinstance(shape, str):
        named = SHAPES.get(Path(shape).stem)  # a file is named after the flat target that it shows
        named = None if named is None or named.is_solid else named
    return OUTLINE_TRACKER if named is None else named.tracker


def list_parameters(shape: str | Corners) -> frozenset[str]:
    """Names of the parameters of a named shape; none of a file and of corners."""
    named = find_shape(shape)
    return frozenset(() if named is None else (field.name for field in fields(named)))


def find_default_size(shape: str) -> tuple[float, ...] | None:
    """Size, m, that programs give a target whose size is not given; None: its file has one."""
    if is_mesh(shape) or Path(shape).suffix.lower() == ".svg":
        return None
    return (0.1, 0.1, 0.1) if is_solid(shape) else (0.1, 0.1)


def make_target(
    shape: str | Corners,
    size: tuple[float, ...] | None = None,
    scale: float | None = None,
    marker: str = "",
) -> Target:
    """The target of a name, of a picture's, an SVG's or a mesh's path, or of a flat polygon's
    corners.

    Args:
        shape, size, scale: as in TargetSpec. marker: that a shape with such a parameter shows.

    Raises:
        ExperimentError: there is none of that name, or its file cannot be used.
    """
    return _make_target(shape, size, scale, marker)


@lru_cache(maxsize=4)  # images and meshes are large
def _make_target(
    shape: str | Corners, size: tuple[float, ...] | None, scale: float | None, marker: str
) -> Target:
    if not isinstance(shape, str):
        return PolygonTarget(shape)
    require(
        scale is None or is_mesh(shape),
        f"target.scale is a factor on a mesh's lengths, and '{shape}' is none: give target.size",
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
        return PolygonTarget(read_svg(path).scale_to_page(size))
    from .textures import read_image_target

    return read_image_target(path, size or DEFAULT_SIZE)


def _make_shape(name: str, parameters: Mapping[str, Any]) -> Target:
    """The target of a named shape, with what is given of its parameters."""
    known = list_parameters(name)
    shape = SHAPES.create(name, **{k: v for k, v in parameters.items() if v and k in known})
    try:
        target = shape.make()
    except ExperimentError:
        raise
    except USER_FAULTS as error:
        raise ExperimentError(
            f"target shape '{name}': make raised {format_error(error)}"
        ) from error
    require(isinstance(target, Target),
            f"target shape '{name}': make returned {type(target).__name__}, must return a Target")
    return target


# -- SVG ---------------------------------------------------------------------------------------


class SvgOutline(NamedTuple):
    """The outline in an SVG file.

    corners: (n, 2) about the middle of the page, x to the right and y up. page: width and height.
    Both in px of CSS. metres: of a px; None where the file gives its page no length.
    """

    corners: np.ndarray
    page: tuple[float, float]
    metres: float | None

    def scale_to_page(self, size: tuple[float, float] | None) -> tuple[tuple[float, float], ...]:
        """Corners, m, on a page of that size along x and y, m, as an image of the drawing has them.

        size: None: the file's own; of one that has none, SIZE for the longer side.
        """
        if size is None:
            factor = np.full(2, self.metres or DEFAULT_SIZE[0] / max(self.page))
        else:
            factor = np.divide(size, self.page)
        return tuple((float(x), float(y)) for x, y in self.corners * factor)


def read_svg(path: Path) -> SvgOutline:
    """The one outline in an SVG file.

    Understood are polygon, polyline, rect, circle, ellipse and path, where their transforms and
    viewBox put them, and lengths with the units mm, cm, in, pt, pc and px (1/96 in). A curve
    becomes SAMPLES edges, an arc CIRCLE_EDGES a turn. A file without width, height and viewBox has
    the box of its outline as its page.

    Raises:
        ExperimentError: it is no SVG, holds entities or too many copies, or none or several
            outlines.
    """
    from svgelements import SVG, Length, Shape

    where = f"target.shape: {path}"
    require(path.stat().st_size <= MAX_SVG_BYTES, f"{where} is larger than {MAX_SVG_BYTES} bytes")
    try:
        text = path.read_text(encoding="utf-8")
        root = safe_xml.parse(text, f"{where} is no SVG", doctype=True)
        count = _count_elements(root)
        require(
            count <= MAX_ELEMENTS,
            f"{where} draws more than {MAX_ELEMENTS} elements, copies by <use> counted: draw the "
            "outline once, as one path",
        )
        lengths = _complete_page_size(root)
        drawing = SVG.parse(
            io.StringIO(tostring(root, encoding="unicode")), reify=False, on_error="raise"
        )
        require(isinstance(drawing, SVG), f"{where} is no SVG: its root is not <svg>")
        shapes = [element for element in drawing.elements() if isinstance(element, Shape)]
        found = [corners for shape in shapes for corners in _find_outlines(shape)]
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
    page, middle = high - low, 0.5 * (low + high)
    if lengths or drawing.viewbox is not None:
        page = np.array([drawing.width, drawing.height], float)
        middle = 0.5 * page
        require(bool((page > 0.0).all()), f"{where}: its width and height must be above 0")
    require(
        bool((np.abs(points - middle) <= MAX_CORNER_DISTANCE * page).all()),
        f"{where}: a corner is more than {MAX_CORNER_DISTANCE:g} pages from the page's middle: "
        "correct it, or "
        "width, height and viewBox",
    )
    metres = 1e-3 / Length("1mm").value(ppi=PPI) if lengths else None
    return SvgOutline((points - middle) * IMAGE_FLIP, tuple(page.tolist()), metres)


def _complete_page_size(root: Element) -> bool:
    """Whether an SVG gives its page a length; the side that it leaves out is set, as the aspect of
    its viewBox has it.

    Raises:
        ValueError: a length or a viewBox that is none, or a page of another aspect than that.
    """
    from svgelements import Length

    sides = {}
    for side in ("width", "height"):
        text = root.get(side, "").strip()
        if not text or text == "auto" or text.endswith("%"):
            root.attrib.pop(side, None)
            continue
        found = re.fullmatch(r"([+-]?[\d.]+(?:e[+-]?\d+)?)\s*([a-z]*)", text, re.IGNORECASE)
        if found is None or found[2].lower() not in UNITS:
            raise ValueError(f"{side} is '{text}', must be a length in {', '.join(UNITS[1:])}")
        sides[side] = float(found[1]), found[2]
    box = _read_view_box(root)
    if len(sides) == 2 and box and root.get("preserveAspectRatio") != "none":
        wide, high = (length * Length(f"1{unit or 'px'}").value(ppi=PPI)
                      for length, unit in sides.values())  # fmt: skip
        if min(wide, high) > 0.0 and abs(wide * box[1] / (high * box[0]) - 1.0) > ASPECT_TOLERANCE:
            raise ValueError(
                f"width {root.get('width')} and height {root.get('height')} have another aspect "
                f"than the viewBox, which is {box[0]:g} by {box[1]:g}: correct one of them"
            )
    if len(sides) == 1 and box:
        ((side, (length, unit)),) = sides.items()
        wide, high = box
        other, ratio = ("height", high / wide) if side == "width" else ("width", wide / high)
        root.set(other, f"{length * ratio!r}{unit}")
        return True
    if len(sides) == 1:
        root.attrib.pop(next(iter(sides)))
    return len(sides) == 2


def _read_view_box(root: Element) -> tuple[float, float] | None:
    """Width and height of an SVG's viewBox, None without one; ValueError for one that is wrong."""
    text = root.get("viewBox")
    if text is None:
        return None
    numbers = [float(word) for word in text.replace(",", " ").split()]
    if len(numbers) != 4 or not np.isfinite(numbers).all() or min(numbers[2:]) <= 0.0:
        raise ValueError(f"viewBox is '{text}', must be x, y, width and height, the last two above "
                         "0")  # fmt: skip
    return numbers[2], numbers[3]


def _count_elements(root: Element) -> int:
    """Elements that are drawn, each copy that <use> makes counted; no further than to the limit."""
    named = {element.get("id"): element for element in root.iter()}
    waiting, count = [root], 0
    while waiting and count <= MAX_ELEMENTS:
        element = waiting.pop()
        count += 1
        waiting.extend(element)
        if element.tag.endswith("use"):
            used = (named.get(value.removeprefix("#")) for name, value in element.items()
                    if name.endswith("href"))  # fmt: skip
            waiting.extend(one for one in used if one is not None)
    return count


def _find_outlines(shape: Shape) -> Iterator[np.ndarray]:
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
