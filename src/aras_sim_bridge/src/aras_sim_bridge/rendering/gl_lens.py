"""One lens: its faces, and how a picture is looked up in the atlas in which they are drawn."""

from __future__ import annotations

import cv2
import moderngl
import numpy as np

from . import shaders
from .faces import around
from .gl_target import Target
from .lens_tiles import LensTiles
from .raymap import RayMap
from .refinement import TILE


class LensPass:
    """One lens: its faces, its lookup texture and the framebuffer of its picture.

    tiles: the picture in tiles, or None where it is smaller than one.
    """

    def __init__(self, ctx: moderngl.Context, lens: RayMap, near: float, far: float) -> None:
        self.lens = lens
        self.faces = around(lens, near, far)
        self.tiles = (LensTiles(lens, near, far) if min(lens.width, lens.height) >= TILE else None)
        self._outside = None if lens.valid.all() else ~lens.valid
        self._nearest = cv2.convertMaps(_extended(lens), None, cv2.CV_16SC2,
                                        nninterpolation=True)[0]
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

    def pick(self, atlas: np.ndarray) -> np.ndarray:
        """Picture (height, width, 4) of the atlas's nearest pixels.

        Continued beyond the rim of the lens, so that no edge is found there; `blacken` ends that.
        """
        return cv2.remap(atlas, self._nearest, None, cv2.INTER_NEAREST)

    def blacken(self, rgba: np.ndarray) -> None:
        """Make what the lens does not show black."""
        if self._outside is not None:
            rgba[self._outside] = (0, 0, 0, 255)

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


def _extended(lens: RayMap) -> np.ndarray:
    """The lookup, with that of the nearest pixel where the lens shows nothing."""
    if lens.valid.all():
        return lens.lookup
    _, label = cv2.distanceTransformWithLabels(
        (~lens.valid).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.zeros((label.max() + 1, 2), np.float32)
    of_label[label[lens.valid]] = lens.lookup[lens.valid]
    return of_label[label]
