"""The renderer: from a view to its picture, depth and segmentation."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from ..errors import RenderingError
from .binning import Binning, Seen
from .finding import found_edges
from .fragments import Edges, Fragments
from .lamps import rows_of
from .measuring import measured
from .recent import Recent
from .sampling import PixelSampler, Samples
from .scene import Scene
from .shading import Shader, word
from .shadows import SUNLIT, Illumination, Irradiance
from .sky import MIDDLE, NO_SKY, sky_words
from .tiles import Tiles
from .triangles import Triangles
from .view import Sun, View

if TYPE_CHECKING:
    from ..world import World

# Where pixels are sampled, px.
CENTRE, UPPER_LEFT = 0.0, -0.5


class _Canvas:
    """What pictures through the same tiles need."""

    def __init__(self, tiles: Tiles) -> None:
        self.tiles = tiles
        self.sampler, self.shader, self.edges = PixelSampler(tiles), Shader(tiles), Edges(tiles)
        self.nbytes = tiles.nbytes + 8 * tiles.valid.size


@dataclass(frozen=True)
class Sampled:
    """What the samples of a view's pixels see.

    Attributes:
        canvas: what all views through the same pixels share.
        seen, samples: the triangles of the pixels, and of their samples.
        optical_T_link: (links, 4, 4) poses of the links in the optical frame.
    """

    canvas: _Canvas
    seen: Seen
    samples: Samples
    optical_T_link: np.ndarray


class Renderer:
    """Draws views of one World on the processor, the same picture on every machine.

    Attributes:
        light: of the pictures that follow.
        triangles: of the scene as it was last drawn; None before.
    """

    def __init__(self, world: World, light: Sun, kept: int) -> None:
        """`kept`: memory for what is prepared for views that come again, bytes."""
        self.scene = Scene(world)
        self.light = light
        self._canvases: Recent[Hashable, _Canvas] = Recent(kept)
        self.triangles: Triangles | None = None
        self._binning: Binning | None = None
        self._illumination: Illumination | None = None
        self._drawn_version = -1
        self._closed = False

    def snapshot(self) -> None:
        """Remember where everything is; `blend` < 1 draws between there and the present."""
        self.scene.snapshot()

    def close(self) -> None:
        """Give the memory back."""
        self._closed = True
        self._canvases.clear()

    def prepare(self, view: View) -> None:
        """Make ready what pictures through the same pixels need.

        Raises RenderingError or MemoryError where they cannot be drawn.
        """
        self._canvas(view)

    def render(self, view: View, blend: float = 1.0) -> np.ndarray:
        """Picture of the view, (height, width, 3) uint8 rgb, top row first."""
        one = self.sample(view, blend, UPPER_LEFT)
        canvas, triangles = one.canvas, self.triangles
        plain = canvas.shader.plain(triangles, one.seen)
        if self.light.lights:
            plain[:] = 0
        edges, fragments, background = self.resolve(one, view, plain)
        light = self._irradiance(one, view, edges, fragments)
        sky = NO_SKY
        if self.light.sky:
            sky = sky_words(canvas.tiles, view.world_T_optical)
        words = canvas.shader.words(triangles, one.seen, one.samples, plain, word(*background),
                                    edges, light, sky)
        canvas.shader.blend(triangles, one.seen, fragments, background, light, sky, words)
        rgba = words.view(np.uint8).reshape(*words.shape, 4)
        return cv2.cvtColor(rgba[:view.height, :view.width], cv2.COLOR_RGBA2RGB)

    def measure(self, view: View, blend: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Depth and segmentation of the view, at the centre of each pixel.

        Depth (height, width) float32, m, inf where nothing is: along the optical axis, or
        along the ray through lenses with pixels that look sideways or back. Segmentation
        (height, width) int32: body id + (link index + 1) << 24 as in Bullet, -1 where nothing is.
        """
        one = self.sample(view, blend, CENTRE)
        labels = self.scene.labels()[self.triangles.row[one.seen.triangle]]
        return measured(one.canvas.tiles, one.seen, one.samples, labels)

    def sample(self, view: View, blend: float, at: float) -> Sampled:
        """What the samples of each pixel see, `at` px from its centre in columns and rows.

        Raises RenderingError once the renderer is closed.
        """
        if self._closed:
            raise RenderingError("the renderer is closed")
        self.scene.refresh()
        # By number, not by what refresh says: a snapshot may have been the one to see the change.
        if self.scene.version != self._drawn_version:
            self._drawn_version = self.scene.version
            self.triangles = Triangles.of(self.scene.parts)
            self._binning = Binning(self.triangles)
            self._illumination = Illumination(self.triangles)
        canvas = self._canvas(view)
        world_T_link = self.scene.poses_at(blend)
        light, optical_T_link = self.light, view.optical_T_world @ world_T_link
        seen = self._binning.seen(
            canvas.tiles, optical_T_link,
            light.to_sun @ world_T_link[:, :3, :3],
            light.scale * np.array([light.ambient, light.diffuse]), view.near, view.far)
        samples = canvas.sampler.samples(seen, view.near, view.far, at)
        return Sampled(canvas, seen, samples, optical_T_link)

    def resolve(self, one: Sampled, view: View, plain: np.ndarray
                ) -> tuple[np.ndarray, Fragments, np.ndarray]:
        """Pixels with edges as in finding.found_edges, what they consist of, and the background's
        rgb (3,) 0..255. plain: the words of the triangles seen."""
        background = 255.0 * np.array(MIDDLE if self.light.sky else self.light.background[:3])
        t = self.triangles
        smooth = t.facets if self.light.lights else t.smooth
        smooth, part = smooth[one.seen.triangle], t.part[one.seen.triangle]
        edges, found = found_edges(one.canvas.tiles, one.seen, one.samples, plain, smooth, part,
                                   word(*background), view.near, view.far)
        fragments = one.canvas.edges.fragments(self.triangles, one.seen, one.samples, found,
                                               plain, view.near, view.far)
        return edges, fragments, background

    def bodies_around(self, point: np.ndarray) -> list[str]:
        """Names 'model::link' of the visuals that the point (3,), world frame, is inside of."""
        return self.scene.bodies_around(point)

    def _canvas(self, view: View) -> _Canvas:
        return self._canvases.get(view.rays_key, lambda: _Canvas(view.tiles()))

    def _irradiance(self, one: Sampled, view: View, edges: np.ndarray, fragments: Fragments
                    ) -> Irradiance:
        """What several lights give; empty where one sun does."""
        light = self.light
        if not light.lights:
            return SUNLIT
        lamps = rows_of(light.lights, view.optical_T_world, light.scale, light.shadows)
        return self._illumination.on(one.canvas.tiles, one.seen, one.samples, edges, fragments,
                                     one.optical_T_link, lamps, light.around)
