"""Targets by name: outlines, made pictures, a PNG, an SVG outline."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from functools import lru_cache
from pathlib import Path

import numpy as np

from aras_visual_servo_base.names import nearest
from aras_visual_servo_controller.settings import OUTLINE

from ..errors import ExperimentError, require
from .geometry import ARAS, PolygonTarget, RoundTarget, Target
from .textures import MADE, from_picture

CIRCLE_EDGES = 180
LARGEST_SVG = 1_000_000  # bytes
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
NAMES = ("aras", "circle", *OUTLINES, *MADE)
# What finds the points of those that are more than an outline.
TRACKERS = {"four_dots": "dots", "marker": "marker", "line_grid": "lines"}


def tracker_of(shape: str | tuple[tuple[float, float], ...]) -> str:
    """Name of the tracker of a target's points, by its shape as in TargetSpec or by its file."""
    return TRACKERS.get(Path(shape).stem, OUTLINE) if isinstance(shape, str) else OUTLINE


@lru_cache(maxsize=32)
def shape_of(
    shape: str | tuple[tuple[float, float], ...], size: tuple[float, float]
) -> Target:
    """The target of a name, of a picture's or an SVG's path, or of a flat polygon's corners.

    Args:
        shape: as in TargetSpec. size: of what has a name or a path, along x and y, m.

    Raises:
        ExperimentError: there is none of that name, or its file cannot be used.
    """
    if not isinstance(shape, str):
        return PolygonTarget(shape)
    if shape == "aras":
        return ARAS
    if shape == "circle":
        return RoundTarget(_scaled(_ring(CIRCLE_EDGES), size))
    if shape in OUTLINES:
        return PolygonTarget(_scaled(OUTLINES[shape], size))
    if shape in MADE:
        return MADE[shape](size)
    path = Path(shape).expanduser()
    require(bool(path.suffix), f"target.shape is '{shape}': {nearest(shape, NAMES)}")
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
    """Corners of the first outline in an SVG file, fitted into a square of side 1 about 0.

    Understood are polygon, polyline, rect, circle, ellipse and the first closed part of a path.

    Raises:
        ExperimentError: it is no SVG, or holds no such outline.
    """
    if path.stat().st_size > LARGEST_SVG:
        raise ExperimentError(f"target.shape: {path} is larger than {LARGEST_SVG} bytes")
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise ExperimentError(f"target.shape: {path} is no SVG: {error}") from None
    for element in root.iter():
        try:
            found = _points_of(element)
        except (KeyError, ValueError, IndexError) as error:
            raise ExperimentError(f"target.shape: {path} has a wrong outline: {error}") from None
        if found is not None and len(found) >= 3:
            points = found if not np.allclose(found[0], found[-1]) else found[:-1]
            low, high = points.min(axis=0), points.max(axis=0)
            require(bool((high > low).all()), f"target.shape: the outline in {path} has no area")
            points = (points - 0.5 * (low + high)) / (high - low).max()
            return tuple((float(x), float(y)) for x, y in points)
    raise ExperimentError(
        f"target.shape: {path} holds no outline: a polygon, rect, circle, ellipse or closed path"
    )


def _points_of(element: ElementTree.Element) -> np.ndarray | None:
    tag = element.tag.rpartition("}")[2]
    if tag in ("polygon", "polyline"):
        return np.array(_numbers(element.attrib["points"])).reshape(-1, 2)
    if tag == "rect":
        x, y = (float(element.get(k, 0.0)) for k in ("x", "y"))
        w, h = (float(element.attrib[k]) for k in ("width", "height"))
        return np.array([[x, y], [x + w, y], [x + w, y + h], [x, y + h]])
    if tag in ("circle", "ellipse"):
        rx = float(element.get("r") or element.attrib["rx"])
        ry = float(element.get("r") or element.attrib["ry"])
        ring = 2.0 * np.array(_ring(CIRCLE_EDGES))
        return ring * (rx, ry) + [float(element.get(k, 0.0)) for k in ("cx", "cy")]
    return _path(element.attrib["d"]) if tag == "path" else None


def _numbers(text: str) -> list[float]:
    return [float(n) for n in re.findall(r"[-+]?(?:\d*\.\d+|\d+\.?)(?:[eE][-+]?\d+)?", text)]


_COUNTS = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "Q": 4, "Z": 0}


def _path(d: str) -> np.ndarray:
    """Points (n, 2) of a path's first part; curves in SAMPLES pieces.

    Raises:
        ValueError: a command that is not understood.
    """
    points: list[np.ndarray] = []
    here = np.zeros(2)
    for command, text in re.findall(r"([A-DF-Za-df-z])([^A-DF-Za-df-z]*)", d):
        kind = command.upper()
        if kind not in _COUNTS:
            raise ValueError(f"path command '{command}' is not understood: use M L H V C Q Z")
        if kind == "Z":
            break
        values = np.array(_numbers(text)).reshape(-1, _COUNTS[kind])
        for row in values:
            base = here if command.islower() else np.zeros(2)
            if kind in "HV":
                axis = "HV".index(kind)
                end = here.copy()
                end[axis] = row[0] + base[axis]
                points.append(end)
            else:
                controls = row.reshape(-1, 2) + base
                if kind in "ML":
                    points.append(controls[0])
                else:
                    points.extend(_bezier(np.vstack([here, controls])))
            here = points[-1]
    return np.array(points)


def _bezier(controls: np.ndarray) -> np.ndarray:
    """Points on a Bezier curve after its first one."""
    p = np.repeat(controls[None], SAMPLES, axis=0)
    t = (np.arange(1, SAMPLES + 1) / SAMPLES)[:, None, None]
    while p.shape[1] > 1:
        p = (1.0 - t) * p[:, :-1] + t * p[:, 1:]
    return p[:, 0]
