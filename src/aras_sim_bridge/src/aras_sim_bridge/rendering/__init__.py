"""Renderer of the camera images, depth images and segmentations of a World.

An image is rendered in these steps:

1. The image is divided into tiles of 8 x 8 px. Each tile has its own pinhole model (tiles.py). For
   a pinhole camera this is exact; for a lens the tiles are divided until the error is small enough.
2. The triangles of the scene are grouped into clusters (triangles.py). Links and clusters that are
   out of view, hidden or turned away from the camera are skipped without a test of their triangles.
   The other triangles are sorted into the tiles that they touch (binning.py).
3. In tiles with several triangles, the nearest triangle at each pixel corner is found
   (pixel_visibility.py).
4. A pixel contains an edge if its corners show different surfaces (corner_edges.py), or if a
   surface of another colour reaches into it (triangle_edge_pixels.py). The colour of such a pixel
   is computed from the exact areas that its triangles cover (visible_areas.py, polygon_areas.py,
   dense_coverage.py). All other pixels are shaded at a corner (shading.py).
5. Depth and segmentation are measured at the pixel centres (depth_and_labels.py).

The renderer runs on the CPU and needs no graphics driver. tests/benchmarks/render.py measures its
time and accuracy. Compared with OpenGL on Mesa's software rasteriser, an image of the ARAS
visual-servoing scene took 0.4 times as long, and an image of a room with 40 000 triangles about 3
times as long, because its many edges are computed exactly.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from aras_visual_servo_base.lazy_imports import lazy_exports

from ..description.types import SHADOWS
from ..errors import RenderingError

if TYPE_CHECKING:
    from ..world import World
    from .renderer import Renderer
    from .view import Lighting, View

__all__ = ["EXPOSURES", "RENDERERS", "SHADOWS", "Lighting", "View", "create_renderer"]

# Valid values of the argument `name` of create_renderer. All of them select the same renderer;
# launch files of earlier versions use 'opengl' and 'tiny'.
RENDERERS = ("auto", "exact", "tiny", "opengl")
# Valid values of Lighting.exposure, the rule that converts light to grey levels.
EXPOSURES = ("unclipped", "gazebo")

# Default size of the cache for data of camera views, bytes: enough for 20 cameras of 1920 x 1200
# px.
CACHE_BYTES = 1 << 28


def create_renderer(
    name: str, world: World, light: Lighting | None = None, cache_bytes: int = CACHE_BYTES
) -> Renderer:
    """Create the renderer of a World.

    Args:
        name: one of RENDERERS.
        world: world to draw.
        light: lighting; None for Gazebo's defaults.
        cache_bytes: largest size, bytes, of the cache for data that depend on a camera's image size
            and lens.

    Raises:
        RenderingError: there is no renderer of this name.
    """
    if name not in RENDERERS:
        raise RenderingError(f"there is no renderer '{name}'; use one of {', '.join(RENDERERS)}")
    from .renderer import Renderer
    from .view import Lighting

    return Renderer(world, light or Lighting(), cache_bytes)


__getattr__, __dir__ = lazy_exports(__name__, {"Lighting": ".view", "View": ".view"})
