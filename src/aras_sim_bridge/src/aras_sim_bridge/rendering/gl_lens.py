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
        self._reach = self._tile_reach()
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

    def seen_in_tiles(self, corners: np.ndarray, triangle: np.ndarray, face: np.ndarray,
                      bounds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pairs (triangle, tile) that overlap, tile by tile; arguments as `on_faces` gives them."""
        column, row = -(-corners // TILE).T
        pairs = []
        for k in range(len(self.lens.faces)):
            first, last = self._reach[k, :, row, column].transpose(1, 0, 2)
            mine = np.flatnonzero(face == k)
            low_x, low_y, high_x, high_y = bounds[:, mine]
            overlap = (high_x > first[:, :1]) & (low_x < last[:, :1])
            overlap &= (high_y > first[:, 1:]) & (low_y < last[:, 1:])
            tile, index = np.nonzero(overlap)
            pairs.append(np.stack([tile, triangle[mine[index]]], axis=1))
        # A triangle can reach a tile on two faces, and must be drawn once.
        tile, triangle = np.unique(np.concatenate(pairs), axis=0).T
        return triangle, tile

    def _tile_reach(self) -> np.ndarray:
        """(faces, 2, rows, columns, 2) lowest and highest face coordinates of each tile.

        Tiles that a face has no pixel of reach from inf to -inf. Widened by the distance between
        pixels, since samples lie around the pixels' centres, and by one more for tiles that
        are moved inwards at the border of the picture.
        """
        h, w = self.lens.valid.shape
        rows, columns = -(-h // TILE), -(-w // TILE)
        v, u = np.mgrid[:h, :w]
        out = np.empty((len(self.lens.faces), 2, rows, columns, 2))
        out[:, 0], out[:, 1] = np.inf, -np.inf
        for k, f in enumerate(self.lens.faces):
            x, y, fw, fh = f.rectangle
            at = (self.lens.lookup - (x, y) + 0.5) * (2.0 / fw, 2.0 / fh) - 1.0
            mine = self.lens.face_of == k
            tile = (v[mine] // TILE, u[mine] // TILE)
            np.minimum.at(out[k, 0], tile, at[mine])
            np.maximum.at(out[k, 1], tile, at[mine])
            size = np.where(np.isfinite(out[k, 1]), out[k, 1] - out[k, 0], 0.0)
            slack = np.maximum(size / (TILE - 1) * 1.5, 4.0 / fw)
            moved = np.zeros((rows, columns, 1))
            moved[-1] += h % TILE > 0
            moved[:, -1] += w % TILE > 0
            slack = slack + np.minimum(moved, 1.0) * size.max()
            out[k, 0] -= slack
            out[k, 1] += slack
        return out

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
