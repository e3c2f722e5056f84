"""Targets by name: outlines, made pictures, a PNG, an SVG outline, a mesh."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from xml.etree.ElementTree import Element, tostring

import numpy as np

from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.names import nearest
from aras_visual_servo_controller.settings import MODEL, OUTLINE

from ..errors import ExperimentError, require
from .geometry import ARAS, FLIPPED, PolygonTarget, RoundTarget, Target
from .shape_names import PICTURES, PRIMITIVES, is_mesh, is_solid

if TYPE_CHECKING:
    from svgelements import Shape

SIZE = (0.2, 0.2)  # m, of a target that has no size of its own
CIRCLE_EDGES = 180
LARGEST_SVG = 1_000_000  # bytes
UNITS = ("", "mm", "cm", "in", "pt", "pc", "px")  # of lengths of an SVG's page
PPI = 96.0  # px in an inch, by CSS
MOST_ELEMENTS = 10_000  # of an SVG, with the copies that <use> makes
SAMPLES = 24  # of each curve of an SVG path
ASPECT = 0.01  # how far a page's may be from its viewBox's: files are rounded
FARTHEST = 100.0  # pages from the page's middle to a corner


def _ring(count: int) -> tuple[tuple[float, float], ...]:
    around = 2.0 * np.pi * np.arange(count) / count
    return tuple(zip((0.5 * np.cos(around)).tolist(), (0.5 * np.sin(around)).tolist(), strict=True))


# Corners within a square of side 1; the size of the target scales them.
OUTLINES: dict[str, tuple[tuple[float, float], ...]] = {
    "square": ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)),
    "triangle": ((-0.5, -0.4), (0.5, -0.3), (-0.1, 0.5)),
    "l_shape": ((-0.5, -0.5), (0.5, -0.5), (0.5, -0.1), (-0.1, -0.1), (-0.1, 0.5), (-0.5, 0.5)),
    "heptagon": _ring(7),
}
NAMES = ("aras", "circle", *OUTLINES, *PICTURES, *PRIMITIVES)
UNMARKED = frozenset(NAMES) - {"marker"}  # that show no ArUco or AprilTag marker
# What finds the points of those that are more than an outline.
TRACKERS = {"four_dots": "dots", "marker": "marker", "line_grid": "lines"}


def tracker_of(shape: str | tuple[tuple[float, float], ...]) -> str:
    """Name of the tracker of a target's points, by its shape as in TargetSpec or by its file."""
    if is_solid(shape):
        return MODEL
    return TRACKERS.get(Path(shape).stem, OUTLINE) if isinstance(shape, str) else OUTLINE


def shape_of(
    shape: str | tuple[tuple[float, float], ...],
    size: tuple[float, ...] | None = None,
    scale: float | None = None,
    marker: str = "",
) -> Target:
    """The target of a name, of a picture's, an SVG's or a mesh's path, or of a flat polygon's
    corners.

    Args:
        shape, size, scale: as in TargetSpec. marker: that the shape 'marker' shows.

    Raises:
        ExperimentError: there is none of that name, or its file cannot be used.
    """
    return _shape_of(shape, size, scale, marker)


@lru_cache(maxsize=4)  # images and meshes are large
def _shape_of(
    shape: str | tuple[tuple[float, float], ...],
    size: tuple[float, ...] | None,
    scale: float | None,
    marker: str,
) -> Target:
    if not isinstance(shape, str):
        return PolygonTarget(shape)
    require(
        scale is None or is_mesh(shape),
        f"target.scale is a factor on a mesh's lengths, and '{shape}' is none: give target.size",
    )
    if shape == "aras":
        return ARAS
    if shape in PRIMITIVES:
        from .solids import primitive

        return primitive(shape, size or (SIZE[0],) * 3)
    path = Path(shape).expanduser()
    if is_mesh(shape):
        from .solids import solid_target

        return solid_target(path, size, scale)
    require(
        size is None or len(size) == 2,
        f"target.size of {shape} is {list(size or ())}, must be two lengths, along x and y, m",
    )
    require(shape in NAMES or bool(path.suffix), f"target.shape is '{shape}': "
            f"{nearest(shape, NAMES)}")
    if path.suffix and shape not in NAMES:
        require(path.is_file(), f"target.shape: there is no file {path}")
    if path.suffix.lower() == ".svg":
        return PolygonTarget(read_svg(path).placed(size))
    size = size or SIZE
    if shape == "circle":
        return RoundTarget(_scaled(_ring(CIRCLE_EDGES), size))
    if shape in OUTLINES:
        return PolygonTarget(_scaled(OUTLINES[shape], size))
    from .textures import MADE, from_picture

    if shape == "marker":
        return MADE[shape](size, marker)
    if shape in MADE:
        return MADE[shape](size)
    return from_picture(path, size)


def default_size(shape: str) -> tuple[float, float] | None:
    """Size, m, that programs give a target whose size is not given; None: its file has one."""
    return None if is_mesh(shape) or Path(shape).suffix.lower() == ".svg" else (0.1, 0.1)


def _scaled(
    corners: tuple[tuple[float, float], ...], size: tuple[float, float]
) -> tuple[tuple[float, float], ...]:
    return tuple((x * size[0], y * size[1]) for x, y in corners)


# -- SVG ---------------------------------------------------------------------------------------


class SvgOutline(NamedTuple):
    """The outline in an SVG file.

    corners: (n, 2) about the middle of the page, x to the right and y up. page: width and height.
    Both in px of CSS. metres: of a px; None where the file gives its page no length.
    """

    corners: np.ndarray
    page: tuple[float, float]
    metres: float | None

    def placed(self, size: tuple[float, float] | None) -> tuple[tuple[float, float], ...]:
        """Corners, m, on a page of that size along x and y, m, as an image of the drawing has them.

        size: None: the file's own; of one that has none, SIZE for the longer side.
        """
        if size is None:
            factor = np.full(2, self.metres or SIZE[0] / max(self.page))
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
    require(path.stat().st_size <= LARGEST_SVG, f"{where} is larger than {LARGEST_SVG} bytes")
    try:
        text = path.read_text(encoding="utf-8")
        root = safe_xml.parse(text, f"{where} is no SVG", doctype=True)
        count = _count_drawn(root)
        require(
            count <= MOST_ELEMENTS,
            f"{where} draws more than {MOST_ELEMENTS} elements, copies by <use> counted: draw the "
            "outline once, as one path",
        )
        lengths = _page(root)
        drawing = SVG.parse(
            io.StringIO(tostring(root, encoding="unicode")), reify=False, on_error="raise"
        )
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
    page, middle = high - low, 0.5 * (low + high)
    if lengths or drawing.viewbox is not None:
        page = np.array([drawing.width, drawing.height], float)
        middle = 0.5 * page
        require(bool((page > 0.0).all()), f"{where}: its width and height must be above 0")
    require(
        bool((np.abs(points - middle) <= FARTHEST * page).all()),
        f"{where}: a corner is more than {FARTHEST:g} pages from the page's middle: correct it, or "
        "width, height and viewBox",
    )
    metres = 1e-3 / Length("1mm").value(ppi=PPI) if lengths else None
    return SvgOutline((points - middle) * FLIPPED, tuple(page.tolist()), metres)


def _page(root: Element) -> bool:
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
    box = _view_box(root)
    if len(sides) == 2 and box and root.get("preserveAspectRatio") != "none":
        wide, high = (length * Length(f"1{unit or 'px'}").value(ppi=PPI)
                      for length, unit in sides.values())  # fmt: skip
        if min(wide, high) > 0.0 and abs(wide * box[1] / (high * box[0]) - 1.0) > ASPECT:
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


def _view_box(root: Element) -> tuple[float, float] | None:
    """Width and height of an SVG's viewBox, None without one; ValueError for one that is wrong."""
    text = root.get("viewBox")
    if text is None:
        return None
    numbers = [float(word) for word in text.replace(",", " ").split()]
    if len(numbers) != 4 or not np.isfinite(numbers).all() or min(numbers[2:]) <= 0.0:
        raise ValueError(f"viewBox is '{text}', must be x, y, width and height, the last two above "
                         "0")  # fmt: skip
    return numbers[2], numbers[3]


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
