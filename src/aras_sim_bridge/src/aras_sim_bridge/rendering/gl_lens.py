"""The lens on the graphics side: one pass that looks every pixel up in the atlas of faces."""

from __future__ import annotations

import cv2
import moderngl
import numpy as np

from . import refinement, shaders
from .faces import Faces, around, looking
from .gl_target import Target
from .raymap import RayMap, tile_samples
from .refinement import TILE

# Samples along the side of a pixel where a tile is drawn again.
FACTOR = 4


class LensPass:
    """One lens: its faces, its lookup texture, and the tiles that were needed so far."""

    def __init__(self, ctx: moderngl.Context, lens: RayMap, near: float, far: float) -> None:
        self.lens = lens
        self.faces = around(lens, near, far)
        self._ctx = ctx
        self._near, self._far = near, far
        # A texel's centre is half a texel from its edge.
        lookup = (lens.lookup + 0.5) / np.array(lens.atlas_size, np.float32)
        self._lookup = ctx.texture((lens.width, lens.height), 2,
                                   np.ascontiguousarray(lookup, np.float32).tobytes(), dtype="f4")
        corners = np.array([[-1, -1], [3, -1], [-1, 3]], "f4")
        self._screen = ctx.buffer(corners.tobytes())
        self._arrays = [self._array(), self._array("FOUR")]
        self._out = Target(ctx, lens.width, lens.height)
        self.rim = self._rim()
        self._tiles: dict[tuple[int, int], int] = {}
        self._rotation = np.zeros((0, 3, 3))
        self._half = np.zeros((0, 2))
        self._samples = np.zeros((0, TILE * FACTOR, TILE * FACTOR, 2), np.float32)

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

    def _rim(self) -> np.ndarray:
        """(rows, columns) tiles that the lens does not show entirely; they are not refined."""
        h, w = self.lens.valid.shape
        rows, columns = -(-h // TILE), -(-w // TILE)
        padded = np.ones((rows * TILE, columns * TILE), bool)
        padded[:h, :w] = self.lens.valid
        inner = padded.reshape(rows, TILE, columns, TILE).all(axis=(1, 3))
        # The samples of a border pixel reach half a pixel further.
        outside = cv2.dilate((~inner).astype(np.uint8), np.ones((3, 3), np.uint8))
        return outside.astype(bool) if not self.lens.valid.all() else ~inner

    def tiles(self, corners: np.ndarray, columns: int, rows: int) -> tuple[Faces, np.ndarray]:
        """Faces for tiles at corners (F, 2) in a columns x rows atlas, and their numbers (F,)."""
        keys = list(map(tuple, corners.tolist()))
        missing = [key for key in keys if key not in self._tiles]
        if missing:
            self._add(missing)
        number = np.array([self._tiles[key] for key in keys])
        return looking(self._rotation[number], self._half[number], columns, rows, self._near,
                       self._far), number

    def _add(self, keys: list[tuple[int, int]]) -> None:
        corners = np.array(keys, float)
        rotation, half, nodes = self.lens.tile_faces(corners, TILE)
        samples = tile_samples(nodes, TILE * FACTOR)
        for key in keys:
            self._tiles[key] = len(self._tiles)
        self._rotation = np.concatenate([self._rotation, rotation])
        self._half = np.concatenate([self._half, half])
        self._samples = np.concatenate([self._samples, samples.astype(np.float32)])

    def paste(self, rgba: np.ndarray, atlas: np.ndarray, corners: np.ndarray,
              number: np.ndarray, columns: int) -> None:
        """Resample the tiles' faces and write them into rgba (height, width, 4)."""
        size = TILE * FACTOR
        rows = atlas.shape[0] // size
        n = np.arange(len(number))
        lookup = np.zeros((rows, size, columns, size, 2), np.float32)
        origin = np.stack([n % columns, n // columns], axis=1)[:, None, None] * size
        at = (self._samples[number] + 1.0) * (size / 2) - 0.5
        # Within the face, so that neighbours in the atlas do not mix.
        at = np.clip(at, 0.0, size - 1.0) + origin
        lookup[n // columns, :, n % columns] = at
        lookup = lookup.reshape(rows * size, columns * size, 2)
        straight = cv2.remap(atlas, lookup, None, cv2.INTER_LINEAR)
        refinement.paste(rgba, straight, corners, FACTOR)

    def release(self) -> None:
        self._lookup.release()
        for thing in (*self._arrays, self._screen):
            thing.release()
        self._out.release()
