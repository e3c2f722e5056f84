"""Renderer on OpenGL 3.3 through EGL: no display needed, a GPU where there is one.

Anti-aliasing ('edges', the default): the picture is drawn with one sample a pixel, then the tiles
in which neighbouring pixels differ are drawn again with 16 samples a pixel (4 where most of
the picture is edges). That costs less than hardware multisampling of the whole picture and is
several times finer. 'multisample' asks the hardware instead.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import moderngl
import numpy as np

from ..errors import RenderingError
from . import refinement, shaders
from .faces import Faces, tiles, whole
from .gl_geometry import Geometry
from .refinement import TILE, EdgeFinder
from .scene import Scene
from .view import Light, MaterialTable, View

ANTIALIASING = ("edges", "multisample", "none")
MULTISAMPLES = 4
ATLAS_COLUMNS = 16
# Share of tiles with edges above which 4 samples a pixel have to do.
FINE_SHARE = 0.35


class OpenGLRenderer:
    """Draws with moderngl. Meshes are uploaded once; poses and the list of what is in view go up
    and pixels come back for each picture."""

    name = "opengl"

    def __init__(
        self, client: int, materials: MaterialTable, light: Light,
        antialiasing: str = "edges",
    ) -> None:
        if antialiasing not in ANTIALIASING:
            raise RenderingError(
                f"anti-aliasing '{antialiasing}' is not known; choose one of "
                + ", ".join(ANTIALIASING)
            )
        self.reason = ""
        self.antialiasing = antialiasing
        self.scene = Scene(client, materials)
        self.light = light
        self._ctx: moderngl.Context | None = create_context()
        self._programs: dict[tuple, moderngl.Program] = {}
        self._targets: dict[tuple, Target] = {}
        self._finders: dict[tuple[int, int], EdgeFinder] = {}
        self._geometry: Geometry | None = None

    def snapshot(self) -> None:
        self.scene.snapshot()

    def forget(self) -> None:
        self.scene.forget()

    def close(self) -> None:
        if self._ctx is not None:
            self._ctx.release()
            self._ctx = None

    def render(self, view: View, blend: float = 1.0) -> np.ndarray:
        optical_T_link, sun = self._prepare(view, blend)
        w, h = view.width, view.height
        faces = whole(view)
        triangle, bounds = self._geometry.visibility.of_face(faces, 0, optical_T_link)
        shown = _Shown(faces, triangle, np.zeros(len(triangle), int), optical_T_link, sun)
        if self.antialiasing == "edges" and min(w, h) < TILE:
            rgba = cv2.resize(self._picture(shown, (4 * w, 4 * h)), (w, h),
                              interpolation=cv2.INTER_AREA)
        elif self.antialiasing == "edges":
            rgba = self._refine(view, self._picture(shown, (w, h)), shown, bounds)
        else:
            samples = MULTISAMPLES if self.antialiasing == "multisample" else 1
            rgba = self._picture(shown, (w, h), samples)
        return cv2.cvtColor(rgba, cv2.COLOR_RGBA2RGB)

    def _prepare(self, view: View, blend: float) -> tuple[np.ndarray, np.ndarray]:
        """Upload what changed; link poses in the optical frame and the sun in link frames."""
        if self._ctx is None:
            raise RenderingError("the renderer is closed")
        if self.scene.refresh() or self._geometry is None:
            if self._geometry is not None:
                self._geometry.release()
            self._geometry = Geometry(self._ctx, self.scene)
        world_T_link = self.scene.poses_at(blend)
        optical_T_link = np.linalg.inv(view.world_T_optical) @ world_T_link
        return optical_T_link, self.light.to_sun @ world_T_link[:, :3, :3]

    def _picture(self, shown: _Shown, size: tuple[int, int], samples: int = 1) -> np.ndarray:
        """Draw into a framebuffer of `size`; its pixels, (height, width, 4)."""
        target = self._target(*size, samples)
        target.draw.use()
        target.draw.clear(*self.light.background)
        self._geometry.draw(self._program(len(shown.faces) > 1), shown.faces, shown.triangle,
                            shown.face, shown.optical_T_link, shown.sun)
        return target.read(self._ctx)

    def _refine(self, view: View, rgba: np.ndarray, shown: _Shown, bounds: np.ndarray
                ) -> np.ndarray:
        """Draw the tiles with edges again, finer, and put them into rgba."""
        w, h = view.width, view.height
        if (w, h) not in self._finders:
            self._finders[w, h] = EdgeFinder(w, h)
        finder = self._finders[w, h]
        found = finder.find(rgba)
        if not len(found):
            return rgba
        if len(found) > FINE_SHARE * finder.rows * finder.columns:
            return cv2.resize(self._picture(shown, (2 * w, 2 * h)), (w, h),
                              interpolation=cv2.INTER_AREA)
        corners = refinement.origins(found, w, h)
        rows = 1 << (-(-len(corners) // ATLAS_COLUMNS) - 1).bit_length()
        first = corners * (2.0 / np.array([w, h])) - 1.0
        triangle, tile = self._geometry.visibility.of_tiles(
            shown.triangle, bounds, first, first + 2.0 * TILE / np.array([w, h])
        )
        fine = _Shown(tiles(view, corners, TILE, ATLAS_COLUMNS, rows), triangle, tile,
                      shown.optical_T_link, shown.sun)
        atlas = self._picture(fine, (ATLAS_COLUMNS * TILE * 4, rows * TILE * 4))
        refinement.paste(rgba, atlas, corners, 4)
        return rgba

    def _program(self, tiled: bool) -> moderngl.Program:
        textured = self._geometry.textures is not None
        key = (tiled, textured)
        if key not in self._programs:
            names = [n for n, on in (("TILED", tiled), ("TEXTURED", textured)) if on]
            self._programs[key] = self._ctx.program(
                vertex_shader=shaders.defined(shaders.MESH_VERTEX, *names),
                fragment_shader=shaders.defined(shaders.MESH_FRAGMENT, *names),
            )
        program = self._programs[key]
        program["light"] = (self.light.ambient, self.light.diffuse)
        return program

    def _target(self, width: int, height: int, samples: int) -> Target:
        key = (width, height, samples)
        if key not in self._targets:
            self._targets[key] = Target(self._ctx, width, height, samples)
        return self._targets[key]


@dataclass(frozen=True)
class _Shown:
    """Triangles (N,), the face each is drawn on (N,), link poses and the sun in link frames."""

    faces: Faces
    triangle: np.ndarray
    face: np.ndarray
    optical_T_link: np.ndarray
    sun: np.ndarray


class Target:
    """A framebuffer, with the plain one it is resolved to where it is multisampled."""

    def __init__(self, ctx: moderngl.Context, width: int, height: int, samples: int) -> None:
        size = (width, height)
        many = samples if samples > 1 else 0
        try:
            self.draw = ctx.framebuffer([ctx.renderbuffer(size, 4, samples=many)],
                                        ctx.depth_renderbuffer(size, samples=many))
            self.plain = ctx.framebuffer([ctx.renderbuffer(size, 4)]) if many else self.draw
        except moderngl.Error as error:
            raise RenderingError(
                f"the graphics driver refuses a picture of {width} x {height} pixels with "
                f"{samples} samples ({error}); make it smaller"
            ) from error
        self._rgba = np.empty((height, width, 4), np.uint8)

    def read(self, ctx: moderngl.Context) -> np.ndarray:
        """Pixels (height, width, 4) uint8, in a buffer that the next read overwrites."""
        if self.plain is not self.draw:
            ctx.copy_framebuffer(self.plain, self.draw)
        self.plain.read_into(self._rgba, components=4)
        return self._rgba


def create_context() -> moderngl.Context:
    """A context without a window.

    Raises RenderingError that says what is missing.
    """
    try:
        return moderngl.create_context(standalone=True, backend="egl", require=330)
    except Exception as error:  # glcontext raises bare Exception for every cause
        raise RenderingError(
            f"EGL gives no OpenGL 3.3 context ({error}); install libegl1 and libgl1-mesa-dri"
        ) from error
