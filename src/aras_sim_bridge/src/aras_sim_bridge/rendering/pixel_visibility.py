"""Sampling of the visible triangle at one point of each pixel.

If a triangle covers a whole tile, the triangles behind it are removed. If none but this triangle is
left, all pixels of the tile show it, and need not be tested. In the other tiles, the triangles are
compared at each pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aras_visual_servo_base.compiled import jit, jit_inline

from .binning import VisibleTriangles
from .tiles import BACKGROUND, NOTHING, SEVERAL, TILE, Tiles


@dataclass
class PixelSamples:
    """Visible triangle at one point, the sample, of each pixel.

    A pixel has the index of a triangle in VisibleTriangles, BACKGROUND, or NOTHING if the pixel is
    outside the image circle of the lens.

    Attributes:
        tile: (tiles,) value of all pixels of a tile; SEVERAL if they may have different values.
        pixel: (rows * TILE, columns * TILE) int32, value of each pixel, in tiles with the value
            SEVERAL.
        start, member, full: triangles that touch each tile with the value SEVERAL; lists as in
            VisibleTriangles.
        pixel_masks: (P,) uint64, bit mask of the pixels that each triangle in `member` may touch.
            The number of a bit is row * TILE + column.
    """

    tile: np.ndarray
    pixel: np.ndarray
    start: np.ndarray
    member: np.ndarray
    full: np.ndarray
    pixel_masks: np.ndarray


class PixelSampler:
    """Samples images that have the same tiles.

    The arrays of a result are overwritten by the next call.
    """

    def __init__(self, tiles: Tiles) -> None:
        self._tiles = tiles
        count = len(tiles.whole)
        self._tile, self._start = np.empty(count, np.int64), np.empty(count + 1, np.int64)
        self._pixel = np.empty((tiles.rows * TILE, tiles.columns * TILE), np.int32)
        self._allocate_members(0)

    def _allocate_members(self, capacity: int) -> None:
        self._member, self._full = np.empty(capacity, np.int64), np.empty(capacity, np.bool_)
        self._masks = np.empty(capacity, np.uint64)

    def sample(
        self, visible: VisibleTriangles, near: float, far: float, offset: float
    ) -> PixelSamples:
        """Find the nearest opaque triangle at the sample of each pixel.

        Args:
            visible: visible triangles.
            near, far: clip distances, m.
            offset: position of the samples, px to the right of the pixel centre and below it.
        """
        t = self._tiles
        room = len(visible.member) + len(self._tile)
        if room > len(self._member):
            self._allocate_members(2 * room)
        left = _sample(
            visible.cover, visible.start, visible.member, visible.full, visible.corner,
            visible.side, visible.cut, visible.opaque, t.matrices, t.inverse, t.spread, t.axis,
            t.nodes, t.whole, t.cells, t.is_uniform, t.columns, near, far, offset, self._tile,
            self._start, self._member, self._full, self._pixel, self._masks,
        )  # fmt: skip
        return PixelSamples(
            self._tile, self._pixel, self._start, self._member[:left], self._full[:left],
            self._masks[:left],
        )  # fmt: skip


@jit("i8[::1], i8[::1], i8[::1], b1[::1], f8[:,:,::1], b1[::1], f8[:,:,::1], f8[:,::1], "
          "b1[::1], i8, i8[::1], i8[::1], i8[::1], b1[::1]")
def _cull_tiles(cover, start, member, full, side, opaque, matrices, nodes, whole, cells, out,
                new_start, new_member, new_full):
    """Remove triangles that are hidden in a whole tile.

    The results are written to out, new_start, new_member and new_full, the arrays `tile`, `start`,
    `member` and `full` of PixelSamples.
    """
    tiles = len(whole)
    left = 0
    per_tile, size = cells * cells, TILE // cells
    difference, rays = np.empty(3), np.empty((4, 3))
    for n in range(tiles):
        new_start[n] = left
        if nodes[n, 3] > 1.5:
            out[n] = NOTHING
        elif start[n] == start[n + 1] and (whole[n] or cover[n] < 0):
            out[n] = cover[n]  # the only triangle of the tile, or BACKGROUND
        else:
            end, pending_cover = left, cover[n]
            for k in range(start[n], start[n + 1] + 1):
                last = k == start[n + 1]
                if pending_cover >= 0 and (last or member[k] > pending_cover):
                    new_member[end], new_full[end] = pending_cover, True
                    end += 1
                    pending_cover = -1
                if not last:
                    new_member[end], new_full[end] = member[k], full[k]
                    end += 1
            # Find the nearest opaque triangle that covers the whole tile.
            best, nearest = -1, 0.0
            for k in range(left, end):
                m = new_member[k]
                if new_full[k] and opaque[m]:
                    w = 0.0
                    for j in range(3):
                        w += nodes[n, j] * (side[m, 0, j] + side[m, 1, j] + side[m, 2, j])
                    if w > nearest:
                        best, nearest = m, w
            if best >= 0 and end > left + 1:
                for k in range(4):
                    # Compute the rays of the tile's four corners, which are corners of the tile's
                    # outermost cells.
                    down, right = k // 2, k % 2
                    c = n * per_tile + (cells - 1) * (down * cells + right)
                    x, y = right * size - 0.5, down * size - 0.5
                    for j in range(3):
                        rays[k, j] = (matrices[c, j, 0] * x + matrices[c, j, 1] * y
                                      + matrices[c, j, 2])
            for k in range(left, end):
                m, all_over = new_member[k], new_full[k]
                hidden = False
                if best >= 0 and m != best:
                    hidden = True
                    for j in range(3):
                        difference[j] = (side[best, 0, j] + side[best, 1, j] + side[best, 2, j]
                                         - side[m, 0, j] - side[m, 1, j] - side[m, 2, j])
                    for corner in range(4):
                        ahead = 0.0
                        for j in range(3):
                            ahead += difference[j] * rays[corner, j]
                        if ahead < -1e-9 * nearest:
                            hidden = False
                if not hidden:
                    new_member[left], new_full[left] = m, all_over
                    left += 1
            one = left == new_start[n] + 1 and new_member[left - 1] == best
            out[n] = best if one else SEVERAL
        if not whole[n] and (out[n] == BACKGROUND or out[n] >= 0):
            out[n] = SEVERAL
    new_start[tiles] = left


@jit_inline
def _find_box(corner, m, inverse, n):
    """Return the image bounding box of triangle m: left, right, top, bottom.

    They are px from the first pixel of tile n. `inverse` is Tiles.inverse.
    """
    left = top = np.inf
    right = bottom = -np.inf
    for j in range(3):
        x, y, z = corner[m, j, 0], corner[m, j, 1], corner[m, j, 2]
        u = inverse[n, 0, 0] * x + inverse[n, 0, 1] * y + inverse[n, 0, 2] * z
        v = inverse[n, 1, 0] * x + inverse[n, 1, 1] * y + inverse[n, 1, 2] * z
        w = inverse[n, 2, 0] * x + inverse[n, 2, 1] * y + inverse[n, 2, 2] * z
        # A corner is not in front of the camera, so the box has no limits.
        if w <= 1e-6 * (abs(u) + abs(v)):
            left = top = -np.inf
            right = bottom = np.inf
            break
        w = 1.0 / w
        u, v = u * w, v * w
        left, right = u if u < left else left, u if u > right else right
        top, bottom = v if v < top else top, v if v > bottom else bottom
    return left, right, top, bottom


@jit("i8[::1], i8[::1], i8[::1], b1[::1], f8[:,:,::1], f8[:,:,::1], b1[::1], b1[::1], "
          "f8[:,:,::1], f8[:,:,::1], f8[::1], f8[:,::1], f8[:,::1], b1[::1], i8, b1, i8, f8, f8, "
          "f8, i8[::1], i8[::1], i8[::1], b1[::1], i4[:,::1], u8[::1]")
def _sample(cover, all_start, all_member, all_full, corner, side, cut, opaque, matrices, inverse,
            spread, axis, nodes, whole, cells, is_uniform, columns, near, far, at, tile, start,
            member, full, pixel, pixel_masks):
    """Find the visible triangle at the sample of each pixel.

    The results are written to the last six arguments, which are the arrays of PixelSamples.
    Triangles that touch no pixel of a tile are removed from the tile's list. Return the total
    length of the remaining lists.

    Args:
        cover, all_start, all_member, all_full: the arrays `cover`, `start`, `member` and `full` of
            VisibleTriangles.
    """
    _cull_tiles(cover, all_start, all_member, all_full, side, opaque, matrices, nodes, whole, cells,
                tile, start, member, full)
    size = TILE // cells
    # For each pixel of a tile: ray (3 rows), length of the ray along the tile's axis, inverse
    # distance and index of the nearest triangle. In a single array, the compiler knows that the
    # rows do not overlap, and can use SIMD instructions.
    work = np.empty((6, TILE, TILE))
    one = np.uint64(1)
    # Image bounding boxes of the triangles; NaN until they are needed.
    box = np.full((len(corner) if is_uniform else 0, 4), np.nan)
    stored, end = 0, start[0]
    for n in range(len(tile)):
        begin, end = end, start[n + 1]
        start[n] = stored
        if tile[n] != SEVERAL:
            continue
        for cell in range(cells * cells):
            c, v, u = n * cells * cells + cell, cell // cells * size, cell % cells * size
            for row in range(v, v + size):
                for column in range(u, u + size):
                    xc, yc = column - u + at, row - v + at
                    x = matrices[c, 0, 0] * xc + matrices[c, 0, 1] * yc + matrices[c, 0, 2]
                    y = matrices[c, 1, 0] * xc + matrices[c, 1, 1] * yc + matrices[c, 1, 2]
                    z = matrices[c, 2, 0] * xc + matrices[c, 2, 1] * yc + matrices[c, 2, 2]
                    work[0, row, column], work[1, row, column], work[2, row, column] = x, y, z
                    work[3, row, column] = axis[n, 0] * x + axis[n, 1] * y + axis[n, 2] * z
                    work[4, row, column], work[5, row, column] = 0.0, BACKGROUND
        u_tile, v_tile = float(TILE * (n % columns)), float(TILE * (n // columns))
        for k in range(begin, end):
            m, all_over = member[k], full[k]
            v0, v1, pixels = 0, TILE - 1, ~np.uint64(0)
            sampled = opaque[m]
            if not all_over:
                if is_uniform:
                    if np.isnan(box[m, 0]):
                        box[m, 0], box[m, 1], box[m, 2], box[m, 3] = _find_box(
                            corner, m, inverse, 0
                        )
                    left, right = box[m, 0] - u_tile, box[m, 1] - u_tile
                    top, bottom = box[m, 2] - v_tile, box[m, 3] - v_tile
                else:
                    left, right, top, bottom = _find_box(corner, m, inverse, n)
                left, right = max(left - spread[n], -1.0), min(right + spread[n], TILE + 0.0)
                top, bottom = max(top - spread[n], -1.0), min(bottom + spread[n], TILE + 0.0)
                u0, u1 = int(np.floor(left + 0.5)), int(np.floor(right + 0.5))
                v0, v1 = int(np.floor(top + 0.5)), int(np.floor(bottom + 0.5))
                u0, u1, v0, v1 = max(u0, 0), min(u1, TILE - 1), max(v0, 0), min(v1, TILE - 1)
                if u0 > u1 or v0 > v1:
                    continue
                across = ((one << np.uint64(u1 - u0 + 1)) - one) << np.uint64(u0)
                # Bit mask of the pixels inside the box; each byte is a row of pixels.
                down = np.uint64(0x0101010101010101) >> np.uint64(8 * (TILE - 1 - v1 + v0))
                pixels = across * (down << np.uint64(8 * v0))
                # First and last row of pixels with samples inside the box.
                v0, v1 = max(int(np.ceil(top - at)), 0), min(int(np.floor(bottom - at)), TILE - 1)
                sampled &= np.ceil(left - at) <= right - at
            member[stored], full[stored], pixel_masks[stored] = m, all_over, pixels
            stored += 1
            if not sampled or v0 > v1:
                continue
            x, y, z = side[m, 0, 0], side[m, 0, 1], side[m, 0, 2]
            x1, y1, z1 = side[m, 1, 0], side[m, 1, 1], side[m, 1, 2]
            x2, y2, z2 = side[m, 2, 0], side[m, 2, 1], side[m, 2, 2]
            # If a triangle covers the whole tile, its sides are not tested: it may represent a
            # quad, and a part of the tile is then outside the triangle itself.
            if all_over:
                x, y, z = x + x1 + x2, y + y1 + y2, z + z1 + z2
                x1 = y1 = z1 = x2 = y2 = z2 = 0.0
            name = float(m)
            low, high = (near, far) if cut[m] else (0.0, np.inf)
            for row in range(v0, v1 + 1):
                for column in range(TILE):
                    rxc, ryc, rzc = work[0, row, column], work[1, row, column], work[2, row, column]
                    l0 = x * rxc + y * ryc + z * rzc
                    l1 = x1 * rxc + y1 * ryc + z1 * rzc
                    l2 = x2 * rxc + y2 * ryc + z2 * rzc
                    w = l0 + l1 + l2
                    a = work[3, row, column]
                    hit = ((l0 >= 0.0) & (l1 >= 0.0) & (l2 >= 0.0) & (w > work[4, row, column])
                           & (low * w <= a) & (high * w >= a))
                    work[4, row, column] = w if hit else work[4, row, column]
                    work[5, row, column] = name if hit else work[5, row, column]
        u, v = TILE * (n % columns), TILE * (n // columns)
        for y0 in range(TILE):
            for x0 in range(TILE):
                pixel[v + y0, u + x0] = work[5, y0, x0]
    start[len(tile)] = stored
    return stored
