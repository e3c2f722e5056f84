"""Which pixels have edges in them: those at whose corners different things are seen.

A straight edge through a pixel always has corners of it on both sides. What reaches into a pixel
without reaching a corner is a triangle's tip, or narrow: it is looked for beside the edges found.
"""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import compiled, inlined

from .binning import Seen
from .sampling import BACKGROUND, NOTHING, SEVERAL, Samples
from .tiles import TILE, Tiles

# Grey levels. What differs by less is as smooth as shading, and an edge of so little contrast that
# one of its sides stands for both moves a target of 100 levels by a thirtieth of a pixel at most.
THRESHOLD = 6


def found_edges(tiles: Tiles, seen: Seen, samples: Samples, plain: np.ndarray, part: np.ndarray,
                sky: np.uint32) -> tuple[np.ndarray, np.ndarray]:
    """Pixels with edges: (tiles,) uint64, bit row * TILE + column of each, and (P,) row * width +
    column, of the padded picture, cell by cell.

    samples: of the pixels' upper left corners. plain: (N,) words of the triangles seen that have
    one colour, 0 for the others; part: (N,) of the triangles seen, negative where it is textured;
    sky: the background's word.
    """
    t = tiles
    edges = _edges(samples.tile, samples.pixel, samples.start, samples.member, seen.opaque, plain,
                   part, sky, seen.side, seen.light, t.matrices, t.valid, t.cells, t.columns)
    tips = _tips(edges, samples.tile, samples.pixel, seen.side, t.matrices, t.valid, t.cells,
                 t.columns)
    edges |= tips
    return edges, _listed(edges, t.cells, t.columns)


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
def _brightness(side, light, m, rx, ry, rz):
    """Light on triangle m, or where it would go on, along a ray."""
    lit = w = 0.0
    for k in range(3):
        share = side[m, k, 0] * rx + side[m, k, 1] * ry + side[m, k, 2] * rz
        w += share
        lit += share * light[m, k]
    return lit / w


@inlined
def _shown(tile, pixel, columns, v, u):
    """What the sample v, u shows; NOTHING where there is none."""
    if v < 0 or u < 0 or v >= pixel.shape[0] or u >= pixel.shape[1]:
        return np.int64(NOTHING)
    whole = tile[(v // TILE) * columns + u // TILE]
    return np.int64(pixel[v, u]) if whole == SEVERAL else whole


@compiled("i8[::1], i4[:,::1], i8[::1], i8[::1], b1[::1], u4[::1], i8[::1], u4, f8[:,:,::1], "
          "f8[:,::1], f8[:,:,::1], b1[:,::1], i8, i8")
def _edges(tile, pixel, start, member, opaque, plain, part, sky, side, light, matrices, valid,
           cells, columns):
    """(tiles,) uint64, pixels whose corners differ in what they show, and those of tiles with
    triangles that one sees through."""
    size, side_of = TILE // cells, TILE + 1
    # The least and the most light on each triangle.
    dim = np.empty((len(light), 2))
    for m in range(len(light)):
        dim[m, 0] = min(light[m, 0], light[m, 1], light[m, 2])
        dim[m, 1] = max(light[m, 0], light[m, 1], light[m, 2])
    out = np.zeros(len(tile), np.uint64)
    shown = np.empty(side_of * side_of, np.int64)
    three = np.empty(3, np.int64)
    for n in range(len(tile)):
        if tile[n] != SEVERAL:
            continue
        through = False
        for k in range(start[n], start[n + 1]):
            through |= not opaque[member[k]]
        u0, v0 = TILE * (n % columns), TILE * (n // columns)
        for y in range(TILE):
            for x in range(TILE):
                shown[y * side_of + x] = pixel[v0 + y, u0 + x]
        for k in range(side_of):
            shown[k * side_of + TILE] = _shown(tile, pixel, columns, v0 + k, u0 + TILE)
            shown[TILE * side_of + k] = _shown(tile, pixel, columns, v0 + TILE, u0 + k)
        bits = np.uint64(0)
        for y in range(TILE):
            for x in range(TILE):
                i = y * side_of + x
                m = shown[i]
                three[0], three[1], three[2] = shown[i + 1], shown[i + side_of], shown[
                    i + side_of + 1]
                if (m == three[0] and m == three[1] and m == three[2] and m != NOTHING
                        and not through) or not valid[v0 + y, u0 + x]:
                    continue
                edge = through or m == NOTHING
                lit, known = 0.0, False
                rx = ry = rz = 0.0
                for k in range(3):
                    other = three[k]
                    if edge or other == m or (k > 0 and other == three[k - 1]):
                        continue
                    if other == NOTHING:
                        edge = True
                    elif m >= 0 and other >= 0 and part[m] == part[other] and part[m] >= 0:
                        # On one smooth part the colour differs by what the slope makes of it.
                        if (max(dim[m, 1], dim[other, 1]) - min(dim[m, 0], dim[other, 0])
                                <= THRESHOLD / 255.0):
                            continue
                        if not known:
                            c = n * cells * cells + (y // size) * cells + x // size
                            xc, yc = float(x % size), float(y % size)
                            rx = (matrices[c, 0, 0] * xc + matrices[c, 0, 1] * yc
                                  + matrices[c, 0, 2])
                            ry = (matrices[c, 1, 0] * xc + matrices[c, 1, 1] * yc
                                  + matrices[c, 1, 2])
                            rz = (matrices[c, 2, 0] * xc + matrices[c, 2, 1] * yc
                                  + matrices[c, 2, 2])
                            lit, known = _brightness(side, light, m, rx, ry, rz), True
                        edge = abs(_brightness(side, light, other, rx, ry, rz) - lit
                                   ) > THRESHOLD / 255.0
                    else:
                        one = sky if m == BACKGROUND else plain[m]
                        two = sky if other == BACKGROUND else plain[other]
                        edge = one == 0 or two == 0 or _apart(one, two)
                if edge:
                    bits |= np.uint64(1) << np.uint64(y * TILE + x)
        out[n] = bits
    return out


@compiled("u8[::1], i8[::1], i4[:,::1], f8[:,:,::1], f8[:,:,::1], b1[:,::1], i8, i8")
def _tips(edges, tile, pixel, side, matrices, valid, cells, columns):
    """(tiles,) uint64, pixels without an edge beside one with an edge, into which a triangle that
    is seen there reaches before what the pixel shows."""
    out = np.zeros(len(tile), np.uint64)
    size = TILE // cells
    rows = len(tile) // columns
    all_left, all_right = np.uint64(0x0101010101010101), np.uint64(0x8080808080808080)
    one = np.uint64(1)
    for n in range(len(tile)):
        if tile[n] != SEVERAL:
            continue
        row, column, own = n // columns, n % columns, edges[n]
        # Of the neighbours to the right, to the left, below and above, which has an edge?
        right = (own & ~all_left) >> one
        left = (own & ~all_right) << one
        below, above = own >> np.uint64(TILE), own << np.uint64(TILE)
        if column + 1 < columns:
            right |= (edges[n + 1] & all_left) << np.uint64(TILE - 1)
        if column > 0:
            left |= (edges[n - 1] & all_right) >> np.uint64(TILE - 1)
        if row + 1 < rows:
            below |= edges[n + columns] << np.uint64(TILE * (TILE - 1))
        if row > 0:
            above |= edges[n - columns] >> np.uint64(TILE * (TILE - 1))
        u0, v0 = TILE * column, TILE * row
        asked = (right | left | below | above) & ~own
        for y in range(TILE):
            if asked >> np.uint64(y * TILE) & np.uint64(255) == 0:
                continue
            for x in range(TILE):
                bit = one << np.uint64(y * TILE + x)
                if asked & bit == 0 or not valid[v0 + y, u0 + x]:
                    continue
                u, v = u0 + x, v0 + y
                here = _shown(tile, pixel, columns, v, u)
                M = matrices[n * cells * cells + (y // size) * cells + x // size]
                xc, yc = float(x % size), float(y % size)
                for k in range(8):
                    # Both far corners of each neighbour.
                    far = k % 2
                    if k < 2:
                        beside, i, j = right & bit != 0, v + far, u + 2
                    elif k < 4:
                        beside, i, j = left & bit != 0, v + far, u - 1
                    elif k < 6:
                        beside, i, j = below & bit != 0, v + 2, u + far
                    else:
                        beside, i, j = above & bit != 0, v - 1, u + far
                    if not beside:
                        continue
                    m = _shown(tile, pixel, columns, i, j)
                    if m < 0 or m == here:
                        continue
                    reaches, ahead = True, 0.0
                    for q in range(3):
                        a = b = c = 0.0
                        for j in range(3):
                            a += side[m, q, j] * M[j, 0]
                            b += side[m, q, j] * M[j, 1]
                            c += side[m, q, j] * M[j, 2]
                        at = a * xc + b * yc + c
                        reaches &= at + 0.5 * (abs(a) + abs(b)) > 0.0
                        ahead += at
                    if not reaches:
                        continue
                    if here >= 0:
                        behind = 0.0
                        for q in range(3):
                            for j in range(3):
                                behind += side[here, q, j] * (M[j, 0] * xc + M[j, 1] * yc
                                                              + M[j, 2])
                        reaches = ahead >= behind * (1.0 - 1e-6)
                    if reaches:
                        out[n] |= bit
    return out


@compiled("u8[::1], i8, i8")
def _listed(edges, cells, columns):
    """(P,) row * width + column, cell by cell."""
    size, width = TILE // cells, TILE * columns
    one = np.uint64(1)
    found = 0
    for n in range(len(edges)):
        bits = edges[n]
        while bits != 0:
            bits &= bits - one
            found += 1
    out = np.empty(found, np.int64)
    found = 0
    for n in range(len(edges)):
        if edges[n] == 0:
            continue
        first = TILE * (n // columns) * width + TILE * (n % columns)
        for place in range(cells * cells * size):
            cell = place // size
            y, x0 = cell // cells * size + place % size, cell % cells * size
            bits = edges[n] >> np.uint64(y * TILE + x0) & ((one << np.uint64(size)) - one)
            for x in range(x0, x0 + size):
                if bits == 0:
                    break
                if bits & one != 0:
                    out[found] = first + y * width + x
                    found += 1
                bits >>= one
    return out
