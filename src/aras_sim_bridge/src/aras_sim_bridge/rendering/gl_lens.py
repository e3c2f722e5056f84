"""The lens on the graphics side: one pass that looks every pixel up in the atlas of faces."""

from __future__ import annotations

import moderngl
import numpy as np

from . import shaders
from .faces import around
from .gl_target import Target
from .raymap import RayMap


class LensPass:
    """One lens: its faces, its lookup texture and the framebuffer of its picture."""

    def __init__(self, ctx: moderngl.Context, lens: RayMap, near: float, far: float) -> None:
        self.lens = lens
        self.faces = around(lens, near, far)
        self._ctx = ctx
        # A texel's centre is half a texel from its edge.
        lookup = (lens.lookup + 0.5) / np.array(lens.atlas_size, np.float32)
        self._lookup = ctx.texture((lens.width, lens.height), 2,
                                   np.ascontiguousarray(lookup, np.float32).tobytes(), dtype="f4")
        corners = np.array([[-1, -1], [3, -1], [-1, 3]], "f4")
        self._screen = ctx.buffer(corners.tobytes())
        self._arrays = [self._array(), self._array("FOUR")]
        self._out = Target(ctx, lens.width, lens.height)

    def _array(self, *names: str) -> moderngl.VertexArray:
        program = self._ctx.program(
            vertex_shader=shaders.SCREEN_VERTEX,
            fragment_shader=shaders.defined(shaders.LENS_FRAGMENT, *names),
        )
        program["atlas"], program["lookup"] = 0, 1
        return self._ctx.vertex_array(program, [(self._screen, "2f4", "corner")])

    def resample(self, atlas: moderngl.Texture) -> np.ndarray:
        """The picture (height, width, 4), in a buffer that the next call overwrites.

        atlas: all faces, at the size of the lens's atlas or, with more samples a pixel, larger.
        """
        self._out.draw.use()
        atlas.use(0)
        self._lookup.use(1)
        self._ctx.enable_only(self._ctx.NOTHING)
        larger = atlas.size[0] > self.lens.atlas_size[0]
        self._arrays[larger].render(self._ctx.TRIANGLES)
        return self._out.read(self._ctx)

    def release(self) -> None:
        self._lookup.release()
        for thing in (*self._arrays, self._screen):
            thing.release()
        self._out.release()
