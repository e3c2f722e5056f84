"""The renderer: pictures of what a World holds.

How a picture is made. A picture is cut into tiles of 8 x 8 px, each seen as
through a pinhole of its own (tiles): a pinhole camera's tiles are exact, a lens's are made small
enough to be. The triangles of the scene lie in clusters (triangles); a link out of view, or a
cluster that is turned away, out of view or behind what covers its tiles is left out by one look,
the others' triangles are sorted into the tiles that they touch (binning). In a tile that one
triangle covers nothing more is to be done; in the others the corners of each pixel are asked which
triangle is nearest (sampling). Where they differ without the shading being the cause, or something
of another colour touches the pixel before that, an edge runs through it (finding), and its colour
is worked out from the areas that its triangles cover (edges, areas, crowd); the others are lit as
their corners say (shading). Depth and segmentation are those of the centres (measuring). All of it
runs on the processor and needs no graphics driver, whose limits and whose rounding differ. The
servo's view takes 0.4 of the time that OpenGL took on Mesa's software rasteriser (at 640 x 480
0.75); a room full of edges and 40 000 triangles, with every edge worked out, take 2.7 to 3.0 times
as long (tests/benchmarks/render.py).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from aras_visual_servo_base.lazy import lazy_exports

from ..description.types import SHADOWS
from ..errors import RenderingError

if TYPE_CHECKING:
    from ..world import World
    from .renderer import Renderer
    from .view import Lighting, View

__all__ = ["EXPOSURES", "RENDERERS", "SHADOWS", "Lighting", "View", "create_renderer"]

# All mean the one renderer: 'opengl' and 'tiny' are what launch files of earlier versions ask for.
RENDERERS = ("auto", "exact", "tiny", "opengl")
# How light becomes grey levels: see Sun.
EXPOSURES = ("unclipped", "gazebo")

# Memory for what is prepared for views that come again, bytes: 20 cameras of 1920 x 1200.
CACHE_BYTES = 1 << 28


def create_renderer(
    name: str, world: World, light: Lighting | None = None, cache_bytes: int = CACHE_BYTES
) -> Renderer:
    """The renderer of a World, by one of RENDERERS; RenderingError for an unknown name.

    kept: memory for what is prepared for views that come again, bytes.
    """
    if name not in RENDERERS:
        raise RenderingError(f"there is no renderer '{name}'; there are {', '.join(RENDERERS)}")
    from .renderer import Renderer
    from .view import Lighting

    return Renderer(world, light or Lighting(), cache_bytes)


__getattr__, __dir__ = lazy_exports(__name__, {"Lighting": ".view", "View": ".view"})
