"""Renderer of images, depth images and segmentations of views."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from aras_visual_servo_base.memory import ByteLimitedCache

from ..errors import RenderingError
from .binning import TileBinning, VisibleTriangles
from .depth_and_labels import measure
from .fragments import FragmentBuilder, Fragments
from .lamps import pack_lights
from .pixel_visibility import PixelSampler, PixelSamples
from .scene import Scene
from .shading import Shader
from .shadows import NO_IRRADIANCE, Irradiance, IrradianceSolver
from .sky import NO_SKY, draw_sky
from .tiles import Tiles
from .triangle_edge_pixels import EdgeFinder
from .triangles import Triangles
from .view import Lighting, View

if TYPE_CHECKING:
    from ..world import World

# Offsets of the sample points from the pixel centre, px; each applies to columns and rows.
CENTRE, UPPER_LEFT = 0.0, -0.5


class _Canvas:
    """Data and work space for images with the same tiles."""

    def __init__(self, tiles: Tiles) -> None:
        self.tiles = tiles
        self.sampler, self.shader = PixelSampler(tiles), Shader(tiles)
        self.edges, self.fragments = EdgeFinder(tiles), FragmentBuilder(tiles)
        self.nbytes = tiles.nbytes + 8 * tiles.valid.size


@dataclass
class SampledView:
    """Samples of the pixels of one view.

    Attributes:
        canvas: data that are shared by all views with the same rays.
        visible: triangles that may be visible.
        samples: visible triangle at the sample of each pixel.
        optical_T_link: (links, 4, 4) poses of the links in the optical frame.
    """

    canvas: _Canvas
    visible: VisibleTriangles
    samples: PixelSamples
    optical_T_link: np.ndarray


class Renderer:
    """Renders views of one World on the CPU, with the same result on every machine.

    Attributes:
        scene: visuals of the world and their poses.
        light: lighting of the next images.
        triangles: triangles of the scene in the last image; None before the first.
    """

    def __init__(self, world: World, light: Lighting, cache_bytes: int) -> None:
        """Create a renderer.

        `cache_bytes` is the largest size of the cache for data that depend on a camera's image size
        and lens.
        """
        self.scene = Scene(world)
        self.light = light
        self._canvases: ByteLimitedCache[Hashable, _Canvas] = ByteLimitedCache(cache_bytes)
        self.triangles: Triangles | None = None
        self._binning: TileBinning | None = None
        self._illumination: IrradianceSolver | None = None
        self._scene_version = -1
        self._closed = False

    def snapshot(self) -> None:
        """Store the present poses. Images with `blend` < 1 interpolate from these poses."""
        self.scene.snapshot()

    def close(self) -> None:
        """Release the memory; the renderer cannot be used afterwards."""
        self._closed = True
        self._canvases.clear()

    def prepare(self, view: View) -> None:
        """Prepare the data for images with the rays of this view.

        Raises:
            RenderingError, MemoryError: such images cannot be rendered.
        """
        self._canvases.get(view.rays_key, lambda: _Canvas(view.get_tiles()))

    def render(self, view: View, blend: float = 1.0) -> np.ndarray:
        """Return the image of the view, (height, width, 3) uint8 rgb, top row first."""
        return cv2.cvtColor(self._draw(view, blend), cv2.COLOR_RGBA2RGB)

    def render_grey(self, view: View, blend: float = 1.0) -> np.ndarray:
        """Return the image of the view in grey, (height, width) uint8.

        A grey level is 0.299 R + 0.587 G + 0.114 B of the levels in `render`, rounded.
        """
        return cv2.cvtColor(self._draw(view, blend), cv2.COLOR_RGBA2GRAY)

    def _draw(self, view: View, blend: float) -> np.ndarray:
        """Return the image of the view, (height, width, 4) uint8 rgba.

        The next call overwrites the image.
        """
        one = self.sample(view, blend, UPPER_LEFT)
        canvas, light = one.canvas, self.light
        edges, fragments = self.resolve(one, view)
        irradiance, sky = NO_IRRADIANCE, NO_SKY
        if light.lights:
            irradiance = self._compute_irradiance(one, view, edges, fragments)
        if light.sky:
            sky = draw_sky(canvas.tiles, view.world_T_optical)
        packed_image = canvas.shader.draw(
            self.triangles, one.visible, one.samples, edges, fragments, light.background_levels,
            light.packed_background, irradiance, sky,
        )  # fmt: skip
        rgba = packed_image.view(np.uint8).reshape(*packed_image.shape, 4)
        return rgba[:view.height, :view.width]

    def measure(self, view: View, blend: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Return the depth and the segmentation of the view at the pixel centres.

        The depth (height, width) float32 is in m, and inf for pixels without a surface. It is
        measured along the optical axis, or along the ray if the lens has pixels that look sideways
        or backwards. The segmentation (height, width) int32 contains body id + ((link index + 1) <<
        24), as in Bullet, and -1 for pixels without a surface.
        """
        one = self.sample(view, blend, CENTRE)
        labels = self.scene.compute_labels()[self.triangles.row[one.visible.triangle]]
        return measure(one.canvas.tiles, one.visible, one.samples, labels)

    def sample(self, view: View, blend: float, offset: float) -> SampledView:
        """Find the visible triangle at one sample of each pixel.

        `offset` is the position of the sample relative to the pixel centre, px; it applies to both
        columns and rows.

        Raises:
            RenderingError: the renderer is closed.
        """
        if self._closed:
            raise RenderingError("the renderer is closed; create another one")
        self.scene.refresh()
        # Compare version numbers, because `snapshot` also calls `refresh`: it may have read a
        # change that the call above does not report again.
        if self.scene.version != self._scene_version:
            self._scene_version = self.scene.version
            self.triangles = Triangles.from_visuals(self.scene.visuals)
            self._binning = TileBinning(self.triangles)
            self._illumination = IrradianceSolver(self.triangles)
        canvas = self._canvases.get(view.rays_key, lambda: _Canvas(view.get_tiles()))
        world_T_link = self.scene.interpolate_poses(blend)
        light, optical_T_link = self.light, view.optical_T_world @ world_T_link
        visible = self._binning.find_visible(
            canvas.tiles, optical_T_link,
            light.to_sun @ world_T_link[:, :3, :3],
            light.sun_levels, view.near, view.far)
        if light.lights:
            visible.colour[:] = 0
        samples = canvas.sampler.sample(visible, view.near, view.far, offset)
        return SampledView(canvas, visible, samples, optical_T_link)

    def resolve(self, sampled: SampledView, view: View) -> tuple[np.ndarray, Fragments]:
        """Find the pixels with edges, and compute the visible parts (fragments) of their triangles.

        Args:
            sampled: samples of the view.
            view: the view.

        Returns:
            Bit masks of the pixels with edges (see EdgeFinder.find), and their fragments.
        """
        g, one, canvas, light = self.triangles, sampled, sampled.canvas, self.light
        edges, edge_pixels = canvas.edges.find(
            g, one.visible, one.samples, g.facets if light.lights else g.smooth,
            light.packed_background, view.near, view.far,
        )  # fmt: skip
        fragments = canvas.fragments.resolve(
            g, one.visible, one.samples, edge_pixels, view.near, view.far)
        return edges, fragments

    def find_bodies_around(self, point: np.ndarray) -> list[str]:
        """Return the names 'model::link' of the links with a visual that contains `point`.

        `point` (3,) is in the world frame, m.
        """
        return self.scene.find_bodies_around(point)

    def _compute_irradiance(
        self, sampled: SampledView, view: View, edges: np.ndarray, fragments: Fragments
    ) -> Irradiance:
        """Return the irradiance from all lights, of which there is at least one."""
        light = self.light
        lamps = pack_lights(light.lights, view.optical_T_world, light.scale, light.shadows)
        return self._illumination.compute_irradiance(
            sampled.canvas.tiles, sampled.visible, sampled.samples, edges, fragments,
            sampled.optical_T_link, lamps, light.ambient_levels)
