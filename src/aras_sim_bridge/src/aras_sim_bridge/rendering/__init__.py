"""Renderers: one interface, pictures of what a World holds.

How a picture is made, by ExactRenderer. A picture is cut into tiles of 8 x 8 px, each seen as
through a pinhole of its own (tiles): a pinhole camera's tiles are exact, a lens's are made small
enough to be. The triangles of the scene lie in clusters (triangles); a link out of view, or a
cluster that is turned away, out of view or behind what covers its tiles is left out by one look,
the others' triangles are sorted into the tiles that they touch (binning). In a tile that one
triangle covers nothing more is to be done; in the others the corners of each pixel are asked which
triangle is nearest (sampling). Where they differ without the shading being the cause, an edge runs
through the pixel (finding), and its colour is worked out from the areas that its triangles cover
(edges, fragments); the others are lit as their corners say (shading). Depth and segmentation are
those of the centres (measuring). All of it runs on the processor and needs no graphics driver,
whose limits and whose rounding differ. The servo's view takes 0.37 of the time that OpenGL took on
Mesa's software rasteriser (at 640 x 480 0.7); a room full of edges and 40 000 triangles, with every
edge worked out, take 2.3 to 2.4 times as long (tests/benchmarks/render.py). 'tiny' draws with
PyBullet's software renderer, to compare.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ..errors import RenderingError
from ..world import World
from .view import Sun, View

__all__ = ["RENDERERS", "Renderer", "Sun", "View", "create_renderer"]

RENDERERS = ("exact", "tiny")
# What launch files of earlier versions ask for.
_OTHER_NAMES = {"auto": "exact", "opengl": "exact"}


class Renderer(Protocol):
    """Draws views of one World. name: which renderer this is."""

    name: str
    light: Sun

    def prepare(self, view: View) -> None:
        """Make ready what pictures through the same pixels need.

        Raises RenderingError or MemoryError where they cannot be drawn.
        """

    def render(self, view: View, blend: float = 1.0) -> np.ndarray:
        """Picture of the view, (height, width, 3) uint8 rgb, top row first."""

    def measure(self, view: View, blend: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Depth and segmentation of the view, at the centre of each pixel.

        Depth (height, width) float32, m, inf where nothing is: along the optical axis, or
        along the ray through lenses with pixels that look sideways or back. Segmentation
        (height, width) int32: body id + (link index + 1) << 24 as in Bullet, -1 where nothing is.
        """

    def bodies_around(self, point: np.ndarray) -> list[str]:
        """Names 'model::link' of the visuals that the point (3,), world frame, is inside of."""

    def snapshot(self) -> None:
        """Remember where everything is; `blend` < 1 draws between there and the present."""

    def close(self) -> None:
        """Give the memory back."""


def create_renderer(name: str, world: World, light: Sun | None = None) -> Renderer:
    """Renderer `name` of a World: 'exact' (as is 'auto', and the old name 'opengl') or 'tiny'.

    Raises RenderingError for an unknown name.
    """
    name = _OTHER_NAMES.get(name, name)
    if name == "exact":
        from .renderer import ExactRenderer

        return ExactRenderer(world, light or Sun())
    if name == "tiny":
        from .tiny import TinyRenderer

        return TinyRenderer(world, light or Sun())
    raise RenderingError(
        f"there is no renderer '{name}'; there are {', '.join(RENDERERS)} and auto")
