"""What the centre of each pixel shows.

Of the triangles in a tile, those are left out that one covering the whole tile hides. A tile of
which nothing else is left shows that one, without a look at its pixels; in the others the
triangles are compared pixel by pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .binning import Seen
from .compiled import compiled
from .tiles import TILE, Tiles

# What a tile or a pixel shows, besides triangles from 0 up.
BACKGROUND, NOTHING, SEVERAL = -1, -2, -3


@dataclass(frozen=True)
class Samples:
    """What pixels show, as numbers in Seen, or BACKGROUND, or NOTHING beyond a lens's rim.

    tile: (tiles,) what the whole tile shows, or SEVERAL.
    pixel: (rows * TILE, columns * TILE) int32; only of tiles with SEVERAL.
    most: what most tiles show.
    start (tiles + 1,), member (P,), full (P,): as in Seen, of the triangles that are left.
    """

    tile: np.ndarray
    pixel: np.ndarray
    most: int
    start: np.ndarray
    member: np.ndarray
    full: np.ndarray


class Sampler:
    """Takes the samples of pictures through the same tiles."""

    def __init__(self, tiles: Tiles) -> None:
        self._tiles = tiles
        self._pixel = np.empty((tiles.rows * TILE, tiles.columns * TILE), np.int32)

    def samples(self, seen: Seen, opaque: np.ndarray, near: float, far: float) -> Samples:
        """opaque: (N,) bool of the triangles seen; the others are left to the edges."""
        t = self._tiles
        tile, most, start, member, full = _settled(
            seen.start, seen.member, seen.full, seen.side, opaque, t.matrices, t.axis, t.nodes,
            t.whole, t.cells)
        _sample(tile, start, member, full, seen.side, seen.cut, opaque, t.matrices, t.axis, t.valid,
                t.cells, t.columns, near, far, self._pixel)
        return Samples(tile, self._pixel, most, start, member, full)


@compiled("i8[::1], i8[::1], b1[::1], f8[:,:,::1], b1[::1], f8[:,:,::1], f8[:,::1], f8[:,::1], "
          "b1[::1], i8")
def _settled(start, member, full, side, opaque, matrices, axis, nodes, whole, cells):
    """See Samples: tile, most, start, member, full."""
    tiles = len(whole)
    out = np.empty(tiles, np.int64)
    new_start, new_member = np.empty(tiles + 1, np.int64), np.empty(len(member), np.int64)
    new_full = np.empty(len(member), np.bool_)
    left = 0
    most, votes = -1, 0
    per_tile, size = cells * cells, TILE // cells
    difference, rays = np.empty(3), np.empty((4, 3))
    for n in range(tiles):
        new_start[n] = left
        if nodes[n, 3] > 1.5:
            out[n] = NOTHING
        elif start[n] == start[n + 1]:
            out[n] = BACKGROUND
        else:
            # The nearest of those that cover the tile.
            best, nearest = -1, 0.0
            for k in range(start[n], start[n + 1]):
                m = member[k]
                if full[k] and opaque[m]:
                    w = 0.0
                    for j in range(3):
                        w += nodes[n, j] * (side[m, 0, j] + side[m, 1, j] + side[m, 2, j])
                    if w > nearest:
                        best, nearest = m, w
            if best >= 0 and start[n + 1] - start[n] > 1:
                for k in range(4):
                    # Corners of the tile, out of its four outermost cells.
                    down, right = k // 2, k % 2
                    c = n * per_tile + (cells - 1) * (down * cells + right)
                    x, y = right * size - 0.5, down * size - 0.5
                    for j in range(3):
                        rays[k, j] = (matrices[c, j, 0] * x + matrices[c, j, 1] * y
                                      + matrices[c, j, 2])
            for k in range(start[n], start[n + 1]):
                m = member[k]
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
                    new_member[left], new_full[left] = m, full[k]
                    left += 1
            one = left == new_start[n] + 1 and new_member[left - 1] == best
            out[n] = best if one else SEVERAL
        if out[n] == BACKGROUND or out[n] >= 0:
            if not whole[n]:
                out[n] = SEVERAL
            elif votes == 0:
                most, votes = out[n], 1
            else:
                votes += 1 if out[n] == most else -1
    new_start[tiles] = left
    return out, most, new_start, new_member[:left], new_full[:left]


@compiled("i8[::1], i8[::1], i8[::1], b1[::1], f8[:,:,::1], b1[::1], b1[::1], f8[:,:,::1], "
          "f8[:,::1], b1[:,::1], i8, i8, f8, f8, i4[:,::1]")
def _sample(tile, start, member, full, side, cut, opaque, matrices, axis, valid, cells, columns,
            near, far, pixel):
    """Fill `pixel` where tiles show several."""
    size = TILE // cells
    last = size - 1.0
    nearest = np.empty(TILE * TILE)
    shown = np.empty(TILE * TILE, np.int32)
    for n in range(len(tile)):
        if tile[n] != SEVERAL:
            continue
        for cell in range(cells * cells):
            c = n * cells * cells + cell
            for i in range(size * size):
                nearest[i], shown[i] = 0.0, BACKGROUND
            for k in range(start[n], start[n + 1]):
                m = member[k]
                if not opaque[m]:
                    continue
                x, y, z = matrices[c, 0, 0], matrices[c, 1, 0], matrices[c, 2, 0]
                a0 = side[m, 0, 0] * x + side[m, 0, 1] * y + side[m, 0, 2] * z
                a1 = side[m, 1, 0] * x + side[m, 1, 1] * y + side[m, 1, 2] * z
                a2 = side[m, 2, 0] * x + side[m, 2, 1] * y + side[m, 2, 2] * z
                x, y, z = matrices[c, 0, 1], matrices[c, 1, 1], matrices[c, 2, 1]
                b0 = side[m, 0, 0] * x + side[m, 0, 1] * y + side[m, 0, 2] * z
                b1 = side[m, 1, 0] * x + side[m, 1, 1] * y + side[m, 1, 2] * z
                b2 = side[m, 2, 0] * x + side[m, 2, 1] * y + side[m, 2, 2] * z
                x, y, z = matrices[c, 0, 2], matrices[c, 1, 2], matrices[c, 2, 2]
                c0 = side[m, 0, 0] * x + side[m, 0, 1] * y + side[m, 0, 2] * z
                c1 = side[m, 1, 0] * x + side[m, 1, 1] * y + side[m, 1, 2] * z
                c2 = side[m, 2, 0] * x + side[m, 2, 1] * y + side[m, 2, 2] * z
                if full[k]:
                    a, b, w0 = a0 + a1 + a2, b0 + b1 + b2, c0 + c1 + c2
                    for y0 in range(size):
                        for x0 in range(size):
                            w = w0 + a * x0 + b * y0
                            if w > nearest[y0 * size + x0]:
                                nearest[y0 * size + x0], shown[y0 * size + x0] = w, m
                    continue
                # The most that each can become along a row, and from row to row.
                most0, most1, most2 = max(a0 * last, 0.0), max(a1 * last, 0.0), max(a2 * last, 0.0)
                if (c0 + most0 + max(b0 * last, 0.0) < 0.0
                        or c1 + most1 + max(b1 * last, 0.0) < 0.0
                        or c2 + most2 + max(b2 * last, 0.0) < 0.0):
                    continue
                for y0 in range(size):
                    row0, row1, row2 = c0 + b0 * y0, c1 + b1 * y0, c2 + b2 * y0
                    if row0 + most0 < 0.0 or row1 + most1 < 0.0 or row2 + most2 < 0.0:
                        continue
                    for x0 in range(size):
                        l0, l1, l2 = row0 + a0 * x0, row1 + a1 * x0, row2 + a2 * x0
                        w = l0 + l1 + l2
                        i = y0 * size + x0
                        if l0 >= 0.0 and l1 >= 0.0 and l2 >= 0.0 and w > nearest[i]:
                            if cut[m]:
                                depth = 0.0
                                for j in range(3):
                                    depth += axis[n, j] * (matrices[c, j, 0] * x0
                                                           + matrices[c, j, 1] * y0
                                                           + matrices[c, j, 2])
                                if depth < near * w or depth > far * w:
                                    continue
                            nearest[i], shown[i] = w, m
            u = TILE * (n % columns) + size * (cell % cells)
            v = TILE * (n // columns) + size * (cell // cells)
            for y0 in range(size):
                for x0 in range(size):
                    there = valid[v + y0, u + x0]
                    pixel[v + y0, u + x0] = shown[y0 * size + x0] if there else NOTHING
