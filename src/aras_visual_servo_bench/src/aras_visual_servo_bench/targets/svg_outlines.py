"""Read the outline of a target from an SVG file."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element, tostring

import numpy as np
from svgelements import SVG, Arc, Close, Length, Line, Move, Shape
from svgelements import Path as Curve

from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.errors import DescriptionError

from ..errors import ExperimentError, require
from .geometry import DEFAULT_SIZE, IMAGE_FLIP

CIRCLE_EDGES = 180  # number of edges that approximate a full circle of an SVG
MAX_SVG_BYTES = 1_000_000
# allowed units of the width and the height of an SVG page
UNITS = ("", "mm", "cm", "in", "pt", "pc", "px")
PPI = 96.0  # pixels per inch, as defined by CSS
MAX_ELEMENTS = 10_000  # maximum number of elements of an SVG, including the copies by <use>
SAMPLES = 24  # number of edges that approximate a curve of an SVG path
# Maximum relative difference between the aspect ratios of an SVG's page and of its viewBox. Files
# often contain rounded values.
ASPECT_TOLERANCE = 0.01
# maximum distance of a corner from the centre of an SVG page, as a multiple of the page's size
MAX_CORNER_DISTANCE = 100.0


class SvgOutline(NamedTuple):
    """Outline in an SVG file.

    corners: corners (n, 2) relative to the page centre, x right and y up, CSS px.
    page: width and height of the page, CSS px.
    metres: length of a CSS px, m; None if the file gives no length for its page.
    """

    corners: np.ndarray
    page: tuple[float, float]
    metres: float | None

    def scale_to_page(self, size: tuple[float, float] | None) -> tuple[tuple[float, float], ...]:
        """Return the corners (x, y), m, after scaling the page.

        size: size of the page along x and y, m. None: the size in the file; for a file without
            lengths, the longer side of the page gets the length DEFAULT_SIZE.
        """
        if size is None:
            factor = np.full(2, self.metres or DEFAULT_SIZE[0] / max(self.page))
        else:
            factor = np.divide(size, self.page)
        return tuple((float(x), float(y)) for x, y in self.corners * factor)


def read_svg(path: Path) -> SvgOutline:
    """Read the outline in an SVG file, which must contain exactly one.

    The function supports polygon, polyline, rect, circle, ellipse and path with their transforms,
    the viewBox, and lengths in mm, cm, in, pt, pc and px (1/96 in). A curve is approximated by
    SAMPLES edges, a full circle by CIRCLE_EDGES edges. If the file has no width, height and
    viewBox, the page is the bounding box of the outline.

    Raises:
        ExperimentError: the file is not an SVG, contains entities or too many elements, or does not
            contain exactly one outline.
    """
    where = f"target.shape: {path}"
    require(path.stat().st_size <= MAX_SVG_BYTES, f"{where} is larger than {MAX_SVG_BYTES} bytes")
    try:
        text = path.read_text(encoding="utf-8")
        root = safe_xml.parse(text, f"{where} is no SVG", doctype=True)
        count = _count_elements(root)
        require(
            count <= MAX_ELEMENTS,
            f"{where} has more than {MAX_ELEMENTS} elements, including copies by <use>: draw the "
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
        raise ExperimentError(f"{where} has an invalid outline: {why}") from None
    require(
        bool(found),
        f"{where} has no outline: add a polygon, rect, circle, ellipse or closed path",
    )
    require(
        len(found) == 1,
        f"{where} has {len(found)} outlines, must have one: remove the other outlines from the "
        "file",
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
        f"{where}: a corner is more than {MAX_CORNER_DISTANCE:g} page sizes from the page centre: "
        "correct the corner, or width, height and viewBox",
    )
    metres = 1e-3 / Length("1mm").value(ppi=PPI) if lengths else None
    return SvgOutline((points - middle) * IMAGE_FLIP, tuple(page.tolist()), metres)


def _complete_page_size(root: Element) -> bool:
    """Compute a missing width or height of an SVG page with the aspect ratio of its viewBox.

    Returns:
        True if the file gives the size of the page with a unit of length.

    Raises:
        ValueError: a length or the viewBox is invalid, or the aspect ratios of page and viewBox
            differ.
    """
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
                f"ratio than the viewBox of {box[0]:g} by {box[1]:g}: correct one of them"
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
    """Return the width and height of an SVG's viewBox; return None if it has no viewBox.

    Raises:
        ValueError: the viewBox is invalid.
    """
    text = root.get("viewBox")
    if text is None:
        return None
    numbers = [float(word) for word in text.replace(",", " ").split()]
    if len(numbers) != 4 or not np.isfinite(numbers).all() or min(numbers[2:]) <= 0.0:
        raise ValueError(f"viewBox is '{text}', must be x, y, width and height, the last two above "
                         "0")  # fmt: skip
    return numbers[2], numbers[3]


def _count_elements(root: Element) -> int:
    """Count the elements of an SVG, including copies by <use>; stop counting above MAX_ELEMENTS."""
    by_id = {element.get("id"): element for element in root.iter()}
    pending, count = [root], 0
    while pending and count <= MAX_ELEMENTS:
        element = pending.pop()
        count += 1
        pending.extend(element)
        if element.tag.endswith("use"):
            copied = (by_id.get(value.removeprefix("#")) for name, value in element.items()
                      if name.endswith("href"))  # fmt: skip
            pending.extend(one for one in copied if one is not None)
    return count


def _find_outlines(shape: Shape) -> Iterator[np.ndarray]:
    """Yield the corners (n, 2) of each subpath of an SVG shape, if the subpath has 3 or more.

    Raises:
        ValueError: the path has an unknown command.
    """
    unknown = re.search(r"[^MZLHVCSQTAE\d\s,.+-]", str(shape.values.get("d", "")), re.IGNORECASE)
    if unknown:
        raise ValueError(
            f"path command '{unknown[0]}' is unknown: use M, L, H, V, C, S, Q, T, A or Z"
        )
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
