"""The renderer: from a view to its picture, depth and segmentation."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from ..errors import RenderingError
from .binning import TileBinning, VisibleTriangles
from .byte_limited_cache import ByteLimitedCache
from .depth_and_labels import measure
from .edge_detection import find_edges
from .fragments import EdgeResolver, Fragments
from .lamps import pack_lights
from .sampling import PixelSampler, PixelSamples
from .scene import Scene
from .shading import Shader, pack_colour
from .shadows import NO_IRRADIANCE, Illumination, Irradiance
from .sky import MIDDLE, NO_SKY, draw_sky
from .tiles import Tiles
from .triangles import Triangles
from .view import Lighting, View

if TYPE_CHECKING:
    from ..world import World

# Where pixels are sampled, px.
CENTRE, UPPER_LEFT = 0.0, -0.5


class _Canvas:
    """What pictures through the same tiles need."""

    def __init__(self, tiles: Tiles) -> None:
        self.tiles = tiles
        self.sampler, self.shader, self.edge_resolver = (
            PixelSampler(tiles),
            Shader(tiles),
            EdgeResolver(tiles),
        )
        self.nbytes = tiles.nbytes + 8 * tiles.valid.size


@dataclass(frozen=True)
class SampledView:
    """What the samples of a view's pixels see.

    Attributes:
        canvas: what all views through the same pixels share.
        seen, samples: the triangles of the pixels, and of their samples.
        optical_T_link: (links, 4, 4) poses of the links in the optical frame.
    """

    canvas: _Canvas
    visible: VisibleTriangles
    samples: PixelSamples
    optical_T_link: np.ndarray


class Renderer:
    """Draws views of one World on the processor, the same picture on every machine.

    Attributes:
        light: of the pictures that follow.
        triangles: of the scene as it was last drawn; None before.
    """

    def __init__(self, world: World, light: Lighting, cache_bytes: int) -> None:
        """`cache_bytes`: memory for what is prepared for views that come again, bytes."""
        self.scene = Scene(world)
        self.light = light
        self._canvases: ByteLimitedCache[Hashable, _Canvas] = ByteLimitedCache(cache_bytes)
        self.triangles: Triangles | None = None
        self._binning: TileBinning | None = None
        self._illumination: Illumination | None = None
        self._scene_version = -1
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
        self._get_canvas(view)

    def render(self, view: View, blend: float = 1.0) -> np.ndarray:
        """Picture of the view, (height, width, 3) uint8 rgb, top row first."""
        one = self.sample(view, blend, UPPER_LEFT)
        canvas, triangles = one.canvas, self.triangles
        plain = canvas.shader.compute_uniform_colours(triangles, one.visible)
        if self.light.lights:
            plain[:] = 0
        edges, fragments, background = self.resolve(one, view, plain)
        light = self._compute_irradiance(one, view, edges, fragments)
        sky = NO_SKY
        if self.light.sky:
            sky = draw_sky(canvas.tiles, view.world_T_optical)
        words = canvas.shader.draw_samples(
            triangles, one.visible, one.samples, plain, pack_colour(*background), edges, light, sky
        )
        canvas.shader.blend_fragments(
            triangles, one.visible, fragments, background, light, sky, words
        )
        rgba = words.view(np.uint8).reshape(*words.shape, 4)
        return cv2.cvtColor(rgba[:view.height, :view.width], cv2.COLOR_RGBA2RGB)

    def measure(self, view: View, blend: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Depth and segmentation of the view, at the centre of each pixel.

        Depth (height, width) float32, m, inf where nothing is: along the optical axis, or
        along the ray through lenses with pixels that look sideways or back. Segmentation
        (height, width) int32: body id + (link index + 1) << 24 as in Bullet, -1 where nothing is.
        """
        one = self.sample(view, blend, CENTRE)
        labels = self.scene.compute_labels()[self.triangles.row[one.visible.triangle]]
        return measure(one.canvas.tiles, one.visible, one.samples, labels)

    def sample(self, view: View, blend: float, offset: float) -> SampledView:
        """What the samples of each pixel see, `offset` px from its centre in columns and rows.

        Raises RenderingError once the renderer is closed.
        """
        if self._closed:
            raise RenderingError("the renderer is closed")
        self.scene.refresh()
        # By number, not by what refresh says: a snapshot may have been the one to see the change.
        if self.scene.version != self._scene_version:
            self._scene_version = self.scene.version
            self.triangles = Triangles.from_visuals(self.scene.visuals)
            self._binning = TileBinning(self.triangles)
            self._illumination = Illumination(self.triangles)
        canvas = self._get_canvas(view)
        world_T_link = self.scene.interpolate_poses(blend)
        light, optical_T_link = self.light, view.optical_T_world @ world_T_link
        seen = self._binning.find_visible(
            canvas.tiles, optical_T_link,
            light.to_sun @ world_T_link[:, :3, :3],
            light.scale * np.array([light.ambient, light.diffuse]), view.near, view.far)
        samples = canvas.sampler.sample(seen, view.near, view.far, offset)
        return SampledView(canvas, seen, samples, optical_T_link)

    def resolve(self, sampled: SampledView, view: View, uniform: np.ndarray
                ) -> tuple[np.ndarray, Fragments, np.ndarray]:
        """Pixels with edges as in finding.found_edges, what they consist of, and the background's
        rgb (3,) 0..255. plain: the words of the triangles seen."""
        background = 255.0 * np.array(MIDDLE if self.light.sky else self.light.background[:3])
        t = self.triangles
        smooth = t.facets if self.light.lights else t.smooth
        smooth, part = smooth[sampled.visible.triangle], t.part[sampled.visible.triangle]
        edges, found = find_edges(
            sampled.canvas.tiles,
            sampled.visible,
            sampled.samples,
            uniform,
            smooth,
            part,
            pack_colour(*background),
            view.near,
            view.far,
        )
        fragments = sampled.canvas.edge_resolver.resolve(
            self.triangles, sampled.visible, sampled.samples, found, uniform, view.near, view.far
        )
        return edges, fragments, background

    def find_bodies_around(self, point: np.ndarray) -> list[str]:
        """Names 'model::link' of the visuals that the point (3,), world frame, is inside of."""
        return self.scene.find_bodies_around(point)

    def _get_canvas(self, view: View) -> _Canvas:
        return self._canvases.get(view.rays_key, lambda: _Canvas(view.get_tiles()))

    def _compute_irradiance(
        self, sampled: SampledView, view: View, edges: np.ndarray, fragments: Fragments
    ) -> Irradiance:
        """What several lights give; empty where one sun does."""
        light = self.light
        if not light.lights:
            return NO_IRRADIANCE
        lamps = pack_lights(light.lights, view.optical_T_world, light.scale, light.shadows)
        return self._illumination.compute_irradiance(
            sampled.canvas.tiles,
            sampled.visible,
            sampled.samples,
            edges,
            fragments,
            sampled.optical_T_link,
            lamps,
            light.ambient_levels,
        )
