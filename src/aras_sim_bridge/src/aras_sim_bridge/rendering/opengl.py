"""Renderer on OpenGL 3.3 through EGL: no display needed, a GPU where there is one.

Anti-aliasing ('edges', the default): the picture is drawn with one sample a pixel, then the tiles
in which neighbouring pixels differ are drawn again with 64 samples a pixel, or everything with 9
or 4 where most tiles have edges. That costs less than hardware multisampling of the whole
picture and measures several times finer. Through lenses tiles take 36 samples a pixel.
'multisample' asks the hardware instead.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import moderngl
import numpy as np

from ..errors import RenderingError
from ..world import World
from . import refinement, shaders
from .faces import Faces, tiles, whole
from .gl_geometry import Geometry, Shown
from .gl_target import Target, create_context
from .lens_view import LensView
from .occluders import Backdrop
from .outlines import Outlines
from .recent import Recent
from .refinement import THRESHOLD, TILE, EdgeFinder
from .regions import Regions
from .scene import Scene
from .view import Sun, View
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
# The same through a lens. With 4 the angle of the target's near square jumps so much that the
# servo loop trembles above 2 % of its error for another second; 8 gains nothing there.
LENS_FINE = 6
# With more triangles than this on the faces of a lens, so many tiles have edges that four places of
# every pixel are looked up, and only tiles with edges of half the range or more drawn again.
LENS_MANY = 200
STRONG = 128
# Samples along a pixel's side in pictures that are full of edges.
DENSE = 3
# With more triangles than this in view there are edges nearly everywhere, and 2 x 2 samples do.
MANY_TRIANGLES = 1500
# Framebuffers of this many sizes are kept: what a picture needs changes with what it shows.
SIZES_KEPT = 24
# So are the look-up tables of this many lenses, which are large, and slow to make.
LENSES_KEPT = 16
# Beyond this many triangles times tiles even finding out what overlaps takes too long.
MOST_PAIRS = 200_000


class OpenGLRenderer:
    """Draws with moderngl. Meshes are uploaded once; poses and the list of what is in view go up
    and pixels come back for each picture."""

    name = "opengl"

    def __init__(
        self, world: World, light: Sun, antialiasing: str = "edges",
    ) -> None:
        if antialiasing not in ANTIALIASING:
            raise RenderingError(
                f"anti-aliasing '{antialiasing}' is not known; choose one of "
                + ", ".join(ANTIALIASING)
            )
        self.reason = ""
        self.antialiasing = antialiasing
        self._samples = MULTISAMPLES if antialiasing == "multisample" else 1
        self.scene = Scene(world)
        self.light = light
        self._ctx: moderngl.Context | None = create_context()
        self._programs: dict[tuple, moderngl.Program] = {}
        self._targets: Recent[tuple, Target] = Recent(SIZES_KEPT, Target.release)
        self._finders: Recent[tuple[int, int], EdgeFinder] = Recent(SIZES_KEPT)
        self._lenses: Recent[tuple, LensView] = Recent(LENSES_KEPT)
        self._face: tuple[tuple, Faces] | None = None
        self._geometry: Geometry | None = None
        self._drawn_version = -1

    def snapshot(self) -> None:
        self.scene.snapshot()

    def close(self) -> None:
        if self._ctx is not None:
            self._ctx.release()
            self._ctx = None

    def render(self, view: View, blend: float = 1.0) -> np.ndarray:
        with self._current():
            optical_T_link, sun = self._prepare(view, blend)
            if view.lens is None:
                return self._flat(view, optical_T_link, sun)
            return _rgb(self._through_lens(view, optical_T_link, sun))

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
        faces = self._whole(view) if lens is None else self._lens(view).faces
        size = (view.width, view.height) if lens is None else lens.atlas_size
        shown = self._shown(faces, optical_T_link, sun)
        key = (*size, "measure")
        target = self._targets.get(
            key, lambda: Target(self._ctx, *size, components=2, dtype="f4")
        )
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
        return Shown(faces, optical_T_link, sun, self._behind(None, sun), triangle, face)

    def _flat(self, view: View, optical_T_link: np.ndarray, sun: np.ndarray) -> np.ndarray:
        """Picture of a pinhole, (height, width, 3)."""
        w, h = view.width, view.height
        faces = self._whole(view)
        seen = self._geometry.visibility.in_view(faces, optical_T_link, MANY_TRIANGLES)
        face = None if seen.triangle is None else np.zeros(len(seen.triangle), int)
        shown = Shown(faces, optical_T_link, sun, self._behind(seen.backdrop, sun), seen.triangle,
                      face, seen.cluster, seen.backdrop, seen.cut)
        if self.antialiasing != "edges":
            return _rgb(self._picture(shown, (w, h), self._samples))
        if min(w, h) < TILE:
            large = self._picture(shown, (4 * w, 4 * h))
            return _rgb(cv2.resize(large, (w, h), interpolation=cv2.INTER_AREA))
        if seen.triangle is None:
            return _rgb(self._denser(shown, w, h, 2))
        regions = Regions.around(seen.outlines, view)
        if regions is None:
            picture = self._everywhere(view, shown, seen.outlines)
        else:
            picture = self._in_regions(view, shown, seen.outlines, regions)
        return _rgb(self._denser(shown, w, h, DENSE)) if picture is None else picture

    def _everywhere(self, view: View, shown: Shown, outlines: Outlines) -> np.ndarray | None:
        """Picture (height, width, 3) with edges drawn finer; None if they are too many."""
        size = view.width, view.height
        rgba = self._picture(shown, size)
        finder = self._finder(*size)
        corners = finder.origins[finder.find(rgba)]
        return _rgb(rgba) if self._refine(rgba, corners, view, corners, shown, outlines) else None

    def _in_regions(self, view: View, shown: Shown, outlines: Outlines, regions: Regions
                    ) -> np.ndarray | None:
        """The same where only the regions differ from the background."""
        picture = np.empty((view.height, view.width, 3), np.uint8)
        picture[0] = np.rint(255 * shown.background[:3])
        picture[1:] = picture[0]
        if not len(regions.rows):
            return picture
        region, index = regions.overlapping(outlines, view)
        parts = replace(shown, faces=regions.faces(view), triangle=shown.triangle[index],
                        face=region)
        rgba = self._picture(parts, regions.atlas_size)
        finder = self._finder(*regions.atlas_size)
        corners = finder.origins[finder.find(rgba)]
        some, origins = regions.in_picture(corners)
        if not self._refine(rgba, corners[some], view, origins, shown, outlines):
            return None
        regions.paste(rgba, picture)
        return picture

    def _through_lens(self, view: View, optical_T_link: np.ndarray, sun: np.ndarray
                      ) -> np.ndarray:
        """Picture through a lens, (height, width, 4): its faces drawn, then looked up."""
        lens = self._lens(view)
        rgba = self._lens_picture(lens, optical_T_link, sun)
        lens.blacken(rgba)
        return rgba

    def _lens_picture(self, lens: LensView, optical_T_link: np.ndarray, sun: np.ndarray
                      ) -> np.ndarray:
        if self.antialiasing != "edges":
            return self._looked_up(lens, self._shown(lens.faces, optical_T_link, sun), 1, 1)
        if lens.tiles is None:
            return self._looked_up(lens, self._shown(lens.faces, optical_T_link, sun), 2, 2)
        shown = replace(self._shown(lens.tiles.reach, optical_T_link, sun), faces=lens.faces)
        if len(shown.triangle) > LENS_MANY:
            rgba, threshold = self._looked_up(lens, shown, 1, 2), STRONG
        else:
            rgba = lens.pick(self._picture(shown, lens.lens.atlas_size))
            threshold = THRESHOLD
        if not self._refine_through(lens, rgba, shown, threshold):
            return self._looked_up(lens, shown, 2, 2)
        return rgba

    def _looked_up(self, lens: LensView, shown: Shown, factor: int, places: int) -> np.ndarray:
        """Picture by looking up places x places of every pixel in the faces, drawn `factor` times
        as wide and high."""
        w, h = lens.lens.atlas_size
        return lens.look_up(self._picture(shown, (factor * w, factor * h), self._samples), places)

    def _refine_through(self, lens: LensView, rgba: np.ndarray, shown: Shown, threshold: int
                        ) -> bool:
        """Draw the tiles with edges above a threshold again, finer, unless they are too many."""
        tiles, visibility = lens.tiles, self._geometry.visibility
        finder = self._finder(rgba.shape[1], rgba.shape[0])
        number = finder.find(rgba, threshold)
        usable = tiles.usable[number]
        if threshold == THRESHOLD and not usable.all():
            return False
        number = number[usable]
        if len(shown.triangle) * len(number) > MOST_PAIRS:
            return False
        outlines = visibility.outlines_on(tiles.reach, shown.triangle, shown.face,
                                          shown.optical_T_link)
        tile, index = outlines.overlapping(tiles.low[number], tiles.high[number],
                                           tiles.home[number], shown.face)
        samples = len(number) * (TILE * LENS_FINE) ** 2 + CLIP_COST * len(index)
        if samples > 3 * lens.lens.atlas_size[0] * lens.lens.atlas_size[1]:
            return False
        faces = tiles.faces(number, ATLAS_COLUMNS, _atlas_rows(len(number)))
        fine = replace(shown, faces=faces, triangle=shown.triangle[index], face=tile)
        self._redraw(rgba, finder.origins[number], fine, LENS_FINE)
        return True

    def _whole(self, view: View) -> Faces:
        """The view as one face; where the eye is does not matter to it."""
        key = (view.width, view.height, view.K.tobytes(), view.near, view.far)
        if self._face is None or self._face[0] != key:
            self._face = key, whole(view)
        return self._face[1]

    def _lens(self, view: View) -> LensView:
        key = (id(view.lens), view.near, view.far)
        # A view keeps its lens, so no other can get that id as long as it is there.
        return self._lenses.get(key, lambda: LensView(view.lens, view.near, view.far))

    def _finder(self, width: int, height: int) -> EdgeFinder:
        return self._finders.get((width, height), lambda: EdgeFinder(width, height))

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
        optical_T_link = view.optical_T_world @ world_T_link
        return optical_T_link, self.light.to_sun @ world_T_link[:, :3, :3]

    def _picture(self, shown: Shown, size: tuple[int, int], samples: int = 1,
                 lattice: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
        """Draw into a framebuffer of `size`; its pixels, (height, width, 4)."""
        key = (*size, samples)
        target = self._targets.get(key, lambda: Target(self._ctx, *size, samples))
        target.draw.use()
        target.draw.clear(*shown.background)
        tiled = len(shown.faces) > 1 or lattice[0] > 0.0
        program = self._program(tiled, cut=shown.cut)
        if tiled:
            program["lattice"] = lattice
        if shown.cut:
            plane = shown.backdrop.plane
            program["backdrop"] = (*plane[:3], plane[3] - TOUCHING)
        self._geometry.draw(program, shown)
        return target.read(self._ctx)

    def _behind(self, backdrop: Backdrop | None, sun: np.ndarray) -> np.ndarray:
        """Colour rgba, 0..1, of what shows where nothing is drawn."""
        if backdrop is None:
            return np.array(self.light.background)
        towards = max(float(backdrop.normal @ sun[backdrop.row]), 0.0)
        shade = self.light.ambient + self.light.diffuse * towards
        return np.minimum(backdrop.rgba * [shade, shade, shade, 1.0], 1.0)

    def _refine(self, rgba: np.ndarray, corners: np.ndarray, view: View, origins: np.ndarray,
                shown: Shown, outlines: Outlines) -> bool:
        """Draw tiles with first pixels `origins` (N, 2) in the view again, finer, and put them into
        rgba at `corners` (N, 2); unless drawing everything denser costs less."""
        if len(shown.triangle) * len(origins) > MOST_PAIRS:
            return False
        low, high = view.in_plane(origins, TILE)
        tile, index = outlines.overlapping(low, high)
        left = DENSE**2 * view.width * view.height - CLIP_COST * len(index)
        if len(origins) * (TILE * FINE) ** 2 > left:
            return False
        faces = tiles(view, origins, TILE, ATLAS_COLUMNS, _atlas_rows(len(origins)))
        fine = replace(shown, faces=faces, triangle=shown.triangle[index], face=tile)
        self._redraw(rgba, corners, fine, FINE)
        return True

    def _redraw(self, rgba: np.ndarray, corners: np.ndarray, fine: Shown, factor: int) -> None:
        """Draw tiles with first pixels (N, 2) with factor^2 samples a pixel, into rgba."""
        if not len(corners):
            return
        size = TILE * (factor + 1)
        atlas = self._picture(fine, (ATLAS_COLUMNS * size, _atlas_rows(len(corners)) * size),
                              lattice=refinement.lattice(factor))
        refinement.paste_sheared(rgba, atlas, corners, factor)

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


def _rgb(rgba: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(rgba, cv2.COLOR_RGBA2RGB)


def _atlas_rows(count: int) -> int:
    """Rows for `count` tiles; above eight in steps, so that few sizes of framebuffer are made."""
    rows = max(1, -(-count // ATLAS_COLUMNS))
    step = max(1, (1 << (rows - 1).bit_length()) // 8)
    return -(-rows // step) * step
