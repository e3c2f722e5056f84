"""Renderer on OpenGL 3.3 through EGL: no display needed, a GPU where there is one.

Anti-aliasing ('edges', the default): the picture is drawn with one sample a pixel, then the tiles
in which neighbouring pixels differ are drawn again with 64 samples a pixel, or everything with 9
or 4 where most tiles have edges. That costs less than hardware multisampling of the whole
picture and measures several times finer. Lenses take 4 samples or more of every pixel.
'multisample' asks the hardware instead.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import moderngl
import numpy as np

from ..errors import RenderingError
from . import refinement, shaders
from .faces import Faces, tiles, whole
from .gl_geometry import Geometry, Shown
from .gl_lens import LensPass
from .gl_target import Target, create_context
from .refinement import TILE, EdgeFinder
from .scene import Scene
from .view import Light, MaterialTable, View
from .visibility import TOUCHING

ANTIALIASING = ("edges", "multisample", "none")
MULTISAMPLES = 4
ATLAS_COLUMNS = 4
# What clipping one triangle to a tile costs, in drawn samples; measured on the software rasteriser.
CLIP_COST = 750
# Samples along a pixel's side in tiles with edges. Over 150 poses the target's area is then right
# to 0.025 % (with 5: 0.05 %, in four fifths of the time), and the angle of its near square to
# 1 mrad where its edges follow the pixels (with 5: 2 mrad, which the servo loop feels).
FINE = 8
# Samples along a pixel's side in pictures that are full of edges.
DENSE = 3
# With more triangles than this in view there are edges nearly everywhere, and 2 x 2 samples do.
MANY_TRIANGLES = 1500
# Beyond this many triangles times tiles even finding out what overlaps takes too long.
MOST_PAIRS = 200_000


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
        self._samples = MULTISAMPLES if antialiasing == "multisample" else 1
        self.scene = Scene(client, materials)
        self.light = light
        self._ctx: moderngl.Context | None = create_context()
        self._programs: dict[tuple, moderngl.Program] = {}
        self._targets: dict[tuple, Target] = {}
        self._finders: dict[tuple[int, int], EdgeFinder] = {}
        self._lenses: dict[tuple, LensPass] = {}
        self._geometry: Geometry | None = None
        self._drawn_version = -1

    def snapshot(self) -> None:
        self.scene.snapshot()

    def forget(self) -> None:
        self.scene.forget()

    def close(self) -> None:
        if self._ctx is not None:
            self._ctx.release()
            self._ctx = None

    def render(self, view: View, blend: float = 1.0) -> np.ndarray:
        with self._current():
            optical_T_link, sun = self._prepare(view, blend)
            if view.lens is not None:
                rgba = self._through_lens(view, optical_T_link, sun)
            else:
                rgba = self._flat(view, optical_T_link, sun)
            return cv2.cvtColor(rgba, cv2.COLOR_RGBA2RGB)

    def _current(self) -> moderngl.Context:
        """Context manager in which OpenGL means this renderer: there may be others."""
        if self._ctx is None:
            raise RenderingError("the renderer is closed")
        return self._ctx

    def measure(self, view: View, blend: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        with self._current():
            return self._measure(view, blend)

    def _measure(self, view: View, blend: float) -> tuple[np.ndarray, np.ndarray]:
        optical_T_link, sun = self._prepare(view, blend)
        lens = view.lens
        faces = whole(view) if lens is None else self._lens(view).faces
        size = (view.width, view.height) if lens is None else lens.atlas_size
        shown = self._shown(faces, optical_T_link, sun)
        key = (*size, "measure")
        if key not in self._targets:
            self._targets[key] = Target(self._ctx, *size, texture=True, components=2, dtype="f4")
        target = self._targets[key]
        target.draw.use()
        target.draw.clear(0.0, 0.0, 0.0, 0.0)
        self._geometry.draw(self._program(len(faces) > 1, measure=True), shown)
        measured = target.read(self._ctx)
        depth, row = measured[..., 0], measured[..., 1]
        if lens is not None:
            depth, row = lens.look_up_depth(depth), lens.look_up(row)
        labels = np.concatenate([[-1], self.scene.labels()]).astype(np.int32)
        return np.where(row > 0.0, depth, np.float32(np.inf)), labels[row.astype(int)]

    def bodies_around(self, point: np.ndarray) -> list[str]:
        return self.scene.bodies_around(point)

    def _shown(self, faces: Faces, optical_T_link: np.ndarray, sun: np.ndarray) -> Shown:
        """What each face can show."""
        triangle, face = self._geometry.visibility.on_faces(faces, optical_T_link)
        return Shown(faces, optical_T_link, sun, triangle, face)

    def _flat(self, view: View, optical_T_link: np.ndarray, sun: np.ndarray) -> np.ndarray:
        """Picture of a pinhole, (height, width, 4)."""
        w, h = view.width, view.height
        faces = whole(view)
        seen = self._geometry.visibility.in_view(faces, optical_T_link, MANY_TRIANGLES)
        face = None if seen.triangle is None else np.zeros(len(seen.triangle), int)
        shown = Shown(faces, optical_T_link, sun, seen.triangle, face, seen.cluster,
                      seen.backdrop, seen.cut)
        if self.antialiasing == "edges" and min(w, h) < TILE:
            return cv2.resize(self._picture(shown, (4 * w, 4 * h)), (w, h),
                              interpolation=cv2.INTER_AREA)
        if self.antialiasing == "edges":
            if seen.triangle is None:
                return self._denser(shown, w, h, 2)
            return self._refine(view, self._picture(shown, (w, h)), shown, seen.bounds)
        return self._picture(shown, (w, h), self._samples)

    def _through_lens(self, view: View, optical_T_link: np.ndarray, sun: np.ndarray
                      ) -> np.ndarray:
        """Picture through a lens, (height, width, 4): its faces drawn, then looked up."""
        lens = self._lens(view)
        w, h = view.lens.atlas_size
        factor = 2 if self.antialiasing == "edges" else 1
        shown = self._shown(lens.faces, optical_T_link, sun)
        target = self._drawn(shown, (factor * w, factor * h), self._samples, texture=True)
        target.resolve(self._ctx)
        return lens.resample(target.texture)

    def _lens(self, view: View) -> LensPass:
        key = (id(view.lens), view.near, view.far)
        if key not in self._lenses:
            self._lenses[key] = LensPass(self._ctx, view.lens, view.near, view.far)
        return self._lenses[key]

    def _finder(self, width: int, height: int) -> EdgeFinder:
        if (width, height) not in self._finders:
            self._finders[width, height] = EdgeFinder(width, height)
        return self._finders[width, height]

    def _prepare(self, view: View, blend: float) -> tuple[np.ndarray, np.ndarray]:
        """Upload what changed; link poses in the optical frame and the sun in link frames."""
        self.scene.refresh()
        # By number, not by what refresh says: a snapshot may have been the one to see the change.
        if self.scene.version != self._drawn_version or self._geometry is None:
            self._drawn_version = self.scene.version
            if self._geometry is not None:
                self._geometry.release()
            self._geometry = Geometry(self._ctx, self.scene)
        world_T_link = self.scene.poses_at(blend)
        optical_T_link = np.linalg.inv(view.world_T_optical) @ world_T_link
        return optical_T_link, self.light.to_sun @ world_T_link[:, :3, :3]

    def _picture(self, shown: Shown, size: tuple[int, int], samples: int = 1,
                 lattice: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
        """Draw into a framebuffer of `size`; its pixels, (height, width, 4)."""
        return self._drawn(shown, size, samples, lattice=lattice).read(self._ctx)

    def _drawn(self, shown: Shown, size: tuple[int, int], samples: int = 1,
               texture: bool = False, lattice: tuple[float, float] = (0.0, 0.0)) -> Target:
        key = (*size, samples, texture)
        if key not in self._targets:
            self._targets[key] = Target(self._ctx, *size, samples, texture)
        target = self._targets[key]
        target.draw.use()
        target.draw.clear(*self._behind(shown))
        tiled = len(shown.faces) > 1 or lattice[0] > 0.0
        program = self._program(tiled, cut=shown.cut)
        if tiled:
            program["lattice"] = lattice
        if shown.cut:
            plane = shown.backdrop.plane
            program["backdrop"] = (*plane[:3], plane[3] - TOUCHING)
        self._geometry.draw(program, shown)
        return target

    def _behind(self, shown: Shown) -> np.ndarray:
        """Colour rgba, 0..1, of what shows where nothing is drawn."""
        backdrop = shown.backdrop
        if backdrop is None:
            return np.array(self.light.background)
        towards = max(float(backdrop.normal @ shown.sun[backdrop.row]), 0.0)
        shade = self.light.ambient + self.light.diffuse * towards
        return np.minimum(backdrop.rgba * [shade, shade, shade, 1.0], 1.0)

    def _refine(self, view: View, rgba: np.ndarray, shown: Shown, bounds: np.ndarray
                ) -> np.ndarray:
        """Draw the tiles with edges again, finer, and put them into rgba."""
        w, h = view.width, view.height
        corners = self._finder(w, h).find(rgba)
        if not len(corners):
            return rgba
        triangle, tile = np.zeros(0, int), np.zeros(0, int)
        left = DENSE**2 * w * h
        if len(shown.triangle) * len(corners) > MOST_PAIRS:
            left = 0
        else:
            first = corners * (2.0 / np.array([w, h])) - 1.0
            triangle, tile = self._geometry.visibility.of_tiles(
                shown.triangle, bounds, first, first + 2.0 * TILE / np.array([w, h])
            )
            left -= CLIP_COST * len(triangle)
        if len(corners) * (TILE * FINE) ** 2 > left:  # drawing everything denser costs less
            return self._denser(shown, w, h, DENSE)
        rows = _atlas_rows(len(corners))
        faces = tiles(view, corners, TILE, ATLAS_COLUMNS, rows)
        fine = replace(shown, faces=faces, triangle=triangle, face=tile)
        size = TILE * (FINE + 1)
        atlas = self._picture(fine, (ATLAS_COLUMNS * size, rows * size),
                              lattice=refinement.lattice(FINE))
        refinement.paste_sheared(rgba, atlas, corners, FINE)
        return rgba

    def _denser(self, shown: Shown, width: int, height: int, factor: int) -> np.ndarray:
        """Picture with factor x factor samples for every pixel; 2 or 3."""
        large = self._picture(shown, (factor * width, factor * height))
        if factor == 3:  # far faster than resizing by three
            return np.ascontiguousarray(cv2.blur(large, (3, 3))[1::3, 1::3])
        return cv2.resize(large, (width, height), interpolation=cv2.INTER_AREA)

    def _program(self, tiled: bool, measure: bool = False, cut: bool = False
                 ) -> moderngl.Program:
        textured = self._geometry.textures is not None and not measure
        switches = {"TILED": tiled, "TEXTURED": textured, "MEASURE": measure, "CUT": cut}
        key = tuple(switches.values())
        if key not in self._programs:
            names = [name for name, on in switches.items() if on]
            fragment = shaders.MEASURE_FRAGMENT if measure else shaders.MESH_FRAGMENT
            self._programs[key] = self._ctx.program(
                vertex_shader=shaders.defined(shaders.MESH_VERTEX, *names),
                fragment_shader=shaders.defined(fragment, *names),
            )
        program = self._programs[key]
        if not measure:
            program["light"] = (self.light.ambient, self.light.diffuse)
        return program


def _atlas_rows(count: int) -> int:
    """Rows for `count` tiles; above eight in steps, so that few sizes of framebuffer are made."""
    rows = max(1, -(-count // ATLAS_COLUMNS))
    step = max(1, (1 << (rows - 1).bit_length()) // 8)
    return -(-rows // step) * step
