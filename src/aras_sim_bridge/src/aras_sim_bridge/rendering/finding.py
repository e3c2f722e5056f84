"""Which pixels have edges in them: where one differs from a neighbour, an edge runs by them."""

from __future__ import annotations

import numpy as np

from aras_sim_bridge.compiled import compiled, inlined

from .binning import Seen
from .sampling import NOTHING, SEVERAL, Samples
from .tiles import TILE, Tiles

# Grey levels. What differs by less is as smooth as shading, and an edge of so little contrast that
# the centre of the pixel decides moves a target of 100 levels by a thirtieth of a pixel at most.
THRESHOLD = 6


def found_edges(tiles: Tiles, seen: Seen, samples: Samples, words: np.ndarray,
                plain: np.ndarray, part: np.ndarray) -> np.ndarray:
    """(P,) row * width + column of pixels with edges, of the padded picture, cell by cell.

    words: the picture with one sample a pixel; part: (N,) of the triangles seen; the rest as in
    Edges.fragments.
    """
    return _found(samples.tile, samples.pixel, samples.start, samples.member, seen.opaque, words,
                  plain, part, seen.side, seen.light, tiles.matrices, tiles.cells, tiles.columns)


@inlined
def _apart(a, b):
    """Whether two colours differ by more than THRESHOLD."""
    apart = False
    for k in range(3):
        shift = np.uint32(8 * k)
        one = np.int32((a >> shift) & np.uint32(255))
        other = np.int32((b >> shift) & np.uint32(255))
        apart |= abs(one - other) > THRESHOLD
    return apart


@inlined
def _brightness(side, light, m, matrices, c, x, y):
    """Light on triangle m, or where it would go on, at x, y of cell c."""
    lit = w = 0.0
    rx = matrices[c, 0, 0] * x + matrices[c, 0, 1] * y + matrices[c, 0, 2]
    ry = matrices[c, 1, 0] * x + matrices[c, 1, 1] * y + matrices[c, 1, 2]
    rz = matrices[c, 2, 0] * x + matrices[c, 2, 1] * y + matrices[c, 2, 2]
    for k in range(3):
        share = side[m, k, 0] * rx + side[m, k, 1] * ry + side[m, k, 2] * rz
        w += share
        lit += share * light[m, k]
    return lit / w


@compiled("i8[::1], i4[:,::1], i8[::1], i8[::1], b1[::1], u4[:,::1], u4[::1], i8[::1], "
          "f8[:,:,::1], f8[:,::1], f8[:,:,::1], i8, i8")
def _found(tile, pixel, start, member, opaque, words, plain, part, side, light, matrices, cells,
           columns):
    """(P,) pixels that differ from one of their eight neighbours, cell by cell, and those of tiles
    with triangles that one sees through."""
    height, width = words.shape
    size = TILE // cells
    out = np.empty(1024, np.int64)
    found = 0
    for n in range(len(tile)):
        if tile[n] != SEVERAL:
            continue
        if found + TILE * TILE > len(out):
            longer = np.empty(2 * len(out), np.int64)
            for k in range(found):
                longer[k] = out[k]
            out = longer
        through = False
        for k in range(start[n], start[n + 1]):
            through |= not opaque[member[k]]
        u0, v0 = TILE * (n % columns), TILE * (n // columns)
        for place in range(cells * cells * size):
            cell, y = place // size, place % size
            c, first = n * cells * cells + cell, u0 + cell % cells * size
            v = v0 + cell // cells * size + y
            above, below = max(v - 1, 0), min(v + 1, height - 1)
            for u in range(first, first + size):
                m = pixel[v, u]
                if m == NOTHING:
                    continue
                # Beyond the border no neighbour would tell.
                edge = through or u == 0 or v == 0 or u == width - 1 or v == height - 1
                word = words[v, u]
                left, right = max(u - 1, 0), min(u + 1, width - 1)
                if not edge and (word == words[above, left] and word == words[above, u]
                                 and word == words[above, right] and word == words[v, left]
                                 and word == words[v, right] and word == words[below, left]
                                 and word == words[below, u] and word == words[below, right]):
                    continue
                for i in range(above, below + 1):
                    for j in range(left, right + 1):
                        if words[i, j] >> np.uint32(24) == 0:
                            edge = True
                        if edge or words[i, j] == word or not _apart(words[i, j], word):
                            continue
                        edge = True
                        # On one smooth part the colour differs by what the slope makes of it.
                        other = tile[(i // TILE) * columns + j // TILE]
                        if other == SEVERAL:
                            other = pixel[i, j]
                        if (m == other or (m >= 0 and other >= 0 and part[m] == part[other]
                                           and plain[m] == 0 and plain[other] == 0)):
                            xn, yn = float(j - first), float(y + i - v)
                            # Both at the neighbour.
                            edge = abs(_brightness(side, light, m, matrices, c, xn, yn)
                                       - _brightness(side, light, other, matrices, c, xn, yn)
                                       ) > THRESHOLD / 255.0
                if edge:
                    out[found] = v * width + u
                    found += 1
    return out[:found]
