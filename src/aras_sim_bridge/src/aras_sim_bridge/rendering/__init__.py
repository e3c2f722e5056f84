"""Renderers: one interface, pictures of what a World holds."""

from __future__ import annotations

import logging
from typing import Protocol

import numpy as np

from ..errors import RenderingError
from ..world import World
from .view import SENSOR_R_OPTICAL, Sun, View

__all__ = ["RENDERERS", "SENSOR_R_OPTICAL", "Sun", "Renderer",
           "View", "create_renderer"]

_log = logging.getLogger(__name__)

RENDERERS = ("opengl", "tiny")


class Renderer(Protocol):
    """Draws views of one World.

    name: which renderer this is; reason: why it was chosen, where that was not asked for.
    """

    name: str
    reason: str

    def render(self, view: View, blend: float = 1.0) -> np.ndarray:
        """Picture of the view, (height, width, 3) uint8 rgb, top row first."""

    def measure(self, view: View, blend: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Depth and segmentation of the view, one sample a pixel.

        Depth (height, width) float32, m, inf where nothing is: along the optical axis, or
        along the ray through lenses with pixels that look sideways or back. Segmentation
        (height, width) int32: body id + (link index + 1) << 24 as in Bullet, -1 where nothing is.
        """

    def bodies_around(self, point: np.ndarray) -> list[str]:
        """Names 'model::link' of the visuals that the point (3,), world frame, is inside of."""

    def snapshot(self) -> None:
        """Remember where everything is; `blend` < 1 draws between there and the present."""

    def close(self) -> None:
        """Give the graphics memory back."""


def create_renderer(
    name: str, world: World, light: Sun | None = None, antialiasing: str = "edges",
) -> Renderer:
    """Renderer `name` of a World.

    'opengl' draws with moderngl on EGL, 'tiny' with PyBullet's software renderer; 'auto' takes
    the first that works and says in `.reason` why not the others. `antialiasing`: 'edges',
    'multisample' or 'none'; 'tiny' knows 'edges' (9 samples a pixel) and 'none'.

    Raises RenderingError for an unknown name, and when a renderer asked for by name does not work.
    """
    light = light or Sun()
    makers = {"opengl": _opengl, "tiny": _tiny}
    if name != "auto" and name not in makers:
        raise RenderingError(
            f"there is no renderer '{name}'; there are {', '.join(RENDERERS)} and auto"
        )
    if name != "auto":
        return makers[name](world, light, antialiasing)
    try:
        return _opengl(world, light, antialiasing)
    except RenderingError as error:
        renderer = _tiny(world, light, "none")
        renderer.reason = f"drawing with 'tiny', which is slow, because {error}"
        _log.warning(renderer.reason)
        return renderer


def _opengl(world: World, light: Sun, antialiasing: str) -> Renderer:
    try:
        from .opengl import OpenGLRenderer
    except ImportError as error:
        raise RenderingError(
            f"the Python package {error.name} is missing; install the requirements"
        ) from error
    return OpenGLRenderer(world, light, antialiasing)


def _tiny(world: World, light: Sun, antialiasing: str) -> Renderer:
    from .tiny import TinyRenderer

    return TinyRenderer(world, light, antialiasing)
