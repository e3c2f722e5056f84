"""Detection of the pixels that contain edges.

A pixel contains an edge if its corners show different surfaces (corner_edges.py). Smaller objects,
such as a wire, a gap between two visuals or the tip of a triangle, may lie between the corners.
Therefore every triangle of the tile whose colour differs from that at the corners is also tested.
The pixel contains an edge if such a triangle reaches into it in front of the surfaces at the
corners. Gaps inside one visual that are narrower than a pixel are not found.
"""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import jit
from aras_visual_servo_base.compiled_bits import lowest_bit

from .binning import VisibleTriangles
from .corner_edges import find_corner_edges, has_contrast
from .pixel_visibility import PixelSamples
from .polygon_areas import COPLANAR_TOLERANCE
from .tiles import SEVERAL, TILE, Tiles
from .triangles import Triangles


class EdgeFinder:
    """Finds the pixels with edges in images that have the same tiles.

    The arrays of a result are overwritten by the next call.
    """

    def __init__(self, tiles: Tiles) -> None:
        self._tiles = tiles
        self._edges, self._multi_part = (np.empty(len(tiles.whole), np.uint64) for _ in range(2))
        self._pixels = np.empty(1024, np.int64)

    def find(
        self,
        triangles: Triangles,
        visible: VisibleTriangles,
        samples: PixelSamples,
        smooth: np.ndarray,
        sky: np.uint32,
        near: float,
        far: float,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the pixels with edges, both as bit masks and as a list.

        Args:
            triangles: triangles of the scene.
            visible: visible triangles.
            samples: samples at the upper left corners of the pixels.
            smooth: Triangles.smooth; Triangles.facets instead if there are several lights.
            sky: packed colour of the background.
            near, far: clip distances, m.

        Returns:
            Bit masks (tiles,) uint64, in which bit row * TILE + column is set if the pixel of the
            tile contains an edge; and the numbers (P,) of these pixels, row * width + column in the
            image enlarged to whole tiles, ordered by tile, and within a tile by cell (see Tiles).
        """
        t = self._tiles
        while True:
            count = _find_edges(
                samples.tile, samples.pixel, samples.start, samples.member, samples.full,
                samples.pixel_masks, visible.opaque, visible.colour, visible.triangle, smooth,
                triangles.part, sky, visible.side, visible.light, visible.cut, t.matrices, t.axis,
                t.valid, t.cells, t.columns, near, far, self._edges, self._multi_part, self._pixels,
            )  # fmt: skip
            if count <= len(self._pixels):
                return self._edges, self._pixels[:count]
            self._pixels = np.empty(2 * count, np.int64)


@jit("u8[::1], u8[::1], i8[::1], i4[:,::1], i8[::1], i8[::1], b1[::1], u8[::1], u4[::1], "
          "i8[::1], i8[::1], u4, f8[:,:,::1], b1[::1], f8[:,:,::1], f8[:,::1], b1[:,::1], i8, i8, "
          "f8, f8")
def _find_thin_edges(
    edges,
    multi_part,
    tile,
    pixel,
    start,
    member,
    full,
    pixel_masks,
    uniform,
    triangle,
    smooth,
    sky,
    side,
    cut,
    matrices,
    axis,
    valid,
    cells,
    columns,
    near,
    far,
):
    """Find edges inside pixels, which the samples at the pixel corners do not show.

    A pixel has such an edge if a surface of another colour is in front of the surfaces at its
    corners, or if the background may be visible through a gap between two visuals. These pixels are
    added to the bit masks `edges`.
    """
    size, one = TILE // cells, np.uint64(1)
    # For each triangle, a number that identifies its colour. Triangles with the same number have
    # the same colour, or belong to the same visual without texture.
    colour = np.empty(len(uniform))
    for m in range(len(uniform)):
        own = smooth[triangle[m]] if smooth[triangle[m]] >= 0 else len(smooth) + m
        colour[m] = float(uniform[m]) if uniform[m] != 0 else -2.0 - own
    longest = 1
    for n in range(len(tile)):
        longest = max(longest, start[n + 1] - start[n])
    # One row of `planes` for each triangle of a tile: the coefficients a, b, c of its inverse
    # distance a + b x + c y, and the largest difference of the inverse distance between a pixel's
    # centre and its corners. `place` is the row of each triangle.
    planes, place = np.empty((longest, 4)), np.empty(len(colour), np.int64)
    # For each pixel: inverse distance of the visible surface, and the number of its colour.
    work = np.empty((2, TILE, TILE))
    line = np.empty((3, 3))
    for n in range(len(tile)):
        if tile[n] != SEVERAL or edges[n] == ~np.uint64(0):
            continue
        u0, v0 = TILE * (n % columns), TILE * (n // columns)
        first, found = start[n], np.uint64(0)
        has_backing = False
        for k in range(first, start[n + 1]):
            has_backing |= full[k]
            place[member[k]] = k - first
        for cell in range(cells * cells):
            y0, x0 = cell // cells * size, cell % cells * size
            M = matrices[n * cells * cells + cell]
            # Bit mask of the pixels in the current cell of the tile. Each byte of the mask is a row
            # of pixels.
            square = ((one << np.uint64(size)) - one) * (
                np.uint64(0x0101010101010101) >> np.uint64(8 * (TILE - size)))
            square <<= np.uint64(y0 * TILE + x0)
            if ~edges[n] & square == 0:
                continue
            for k in range(start[n + 1] - first):
                if pixel_masks[first + k] & square == 0:
                    continue
                m = member[first + k]
                a = b = c = 0.0
                for q in range(3):
                    s = side[m, 0, q] + side[m, 1, q] + side[m, 2, q]
                    a, b, c = a + s * M[q, 2], b + s * M[q, 0], c + s * M[q, 1]
                planes[k, 0], planes[k, 1], planes[k, 2] = a, b, c
                planes[k, 3] = 0.5 * (abs(b) + abs(c))
            nearest, pixels, one_colour, last = np.inf, np.uint64(0), True, -1.0
            for y in range(size):
                for x in range(size):
                    i, j = y0 + y, x0 + x
                    bit = one << np.uint64(i * TILE + j)
                    work[0, y, x], work[1, y, x] = np.inf, -1.0
                    if edges[n] & bit != 0 or not valid[v0 + i, u0 + j]:
                        continue
                    m = np.int64(pixel[v0 + i, u0 + j])
                    front, name = 0.0, float(sky) if m < 0 else colour[m]
                    if multi_part[n] & bit != 0:
                        # Between two visuals of the same colour there may be a gap. If no triangle
                        # is behind the gap, the background is visible.
                        if (
                            not has_backing
                            and m >= 0
                            and (name < 0.0 or has_contrast(np.uint32(name), sky))
                        ):
                            found |= bit
                            continue
                    elif m >= 0:
                        k = place[m]
                        front = (planes[k, 0] + planes[k, 1] * x + planes[k, 2] * y
                                 - planes[k, 3])
                    work[0, y, x], work[1, y, x] = front, name
                    nearest = min(nearest, front)
                    pixels |= bit
                    one_colour &= last == -1.0 or last == name
                    last = name
            if pixels == 0:
                continue
            for k in range(start[n + 1] - first):
                bits = pixel_masks[first + k] & pixels & ~found
                if bits == 0:
                    continue
                m = member[first + k]
                name = colour[m]
                a, b, c = planes[k, 0] + planes[k, 3], planes[k, 1], planes[k, 2]
                if (one_colour and last == name
                        or a + (size - 1) * (max(b, 0.0) + max(c, 0.0)) <= nearest):
                    continue
                # Sides of the triangle as lines relative to the cell's first pixel. They are moved
                # outwards by half a pixel, so that the centre of any pixel that the triangle
                # touches is inside them.
                for i in range(3):
                    for j in range(3):
                        line[i, j] = (side[m, i, 0] * M[0, j] + side[m, i, 1] * M[1, j]
                                      + side[m, i, 2] * M[2, j])
                    line[i, 2] += 0.5 * (abs(line[i, 0]) + abs(line[i, 1]))
                    if full[first + k]:
                        line[i, 2] = np.inf
                b0, c0, a0 = line[0, 0], line[0, 1], line[0, 2]
                b1, c1, a1 = line[1, 0], line[1, 1], line[1, 2]
                b2, c2, a2 = line[2, 0], line[2, 1], line[2, 2]
                rows = np.int64(0)
                for y in range(size):
                    if bits >> np.uint64((y0 + y) * TILE) & np.uint64(255) == 0:
                        continue
                    hits = np.int64(0)
                    for x in range(size):
                        hit = ((a0 + b0 * x + c0 * y > 0.0) & (a1 + b1 * x + c1 * y > 0.0)
                               & (a2 + b2 * x + c2 * y > 0.0)
                               & (a + b * x + c * y > work[0, y, x]) & (work[1, y, x] != name))
                        hits |= np.int64(hit)
                    rows |= hits << y
                while rows != 0:
                    y = lowest_bit(rows)
                    rows &= rows - 1
                    for x in range(size):
                        bit = one << np.uint64((y0 + y) * TILE + x0 + x)
                        w = a + b * x + c * y
                        if (bits & bit == 0 or work[1, y, x] == name or w <= work[0, y, x]
                                or a0 + b0 * x + c0 * y <= 0.0 or a1 + b1 * x + c1 * y <= 0.0
                                or a2 + b2 * x + c2 * y <= 0.0):
                            continue
                        if name >= 0.0 and work[1, y, x] >= 0.0 and not has_contrast(
                                np.uint32(name), np.uint32(work[1, y, x])):
                            continue
                        # Skip the triangle if, in the whole pixel, it is nearer than `near` or
                        # farther than `far`.
                        if cut[m]:
                            along = by = 0.0
                            for q in range(3):
                                along += axis[n, q] * (M[q, 0] * x + M[q, 1] * y + M[q, 2])
                                by += 0.5 * abs(axis[n, q]) * (abs(M[q, 0]) + abs(M[q, 1]))
                            if (far * w <= along - by
                                    or near * (w - 2.0 * planes[k, 3]) >= along + by):
                                continue
                        if work[0, y, x] > 0.0:
                            # Skip the triangle if, in the whole pixel, it is behind the triangle
                            # that the pixel shows.
                            q = place[np.int64(pixel[v0 + y0 + y, u0 + x0 + x])]
                            d, e = planes[k, 1] - planes[q, 1], planes[k, 2] - planes[q, 2]
                            if (
                                planes[k, 0]
                                - planes[q, 0]
                                + d * x
                                + e * y
                                + 0.5 * (abs(d) + abs(e))
                                <= COPLANAR_TOLERANCE * work[0, y, x]
                            ):
                                continue
                        found |= bit
        edges[n] |= found


@jit("u8[::1], i8, i8, i8[::1]")
def _list_pixels(edges, cells, columns, out):
    """Write the numbers of the pixels that are set in the bit masks `edges` to `out`.

    The number of a pixel is row * width + column. The numbers are ordered by tile, and within a
    tile by cell, of which there are `cells` x `cells`. Return how many there are; if `out` has no
    room for them, nothing is written.
    """
    size, width = TILE // cells, TILE * columns
    one = np.uint64(1)
    found = 0
    for n in range(len(edges)):
        bits = edges[n]
        while bits != 0:
            bits &= bits - one
            found += 1
    if found > len(out):
        return found
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
    return found


@jit("i8[::1], i4[:,::1], i8[::1], i8[::1], b1[::1], u8[::1], b1[::1], u4[::1], i8[::1], i8[::1], "
          "i8[::1], u4, f8[:,:,::1], f8[:,::1], b1[::1], f8[:,:,::1], f8[:,::1], b1[:,::1], i8, "
          "i8, f8, f8, u8[::1], u8[::1], i8[::1]")
def _find_edges(tile, pixel, start, member, full, pixel_masks, opaque, uniform, triangle, smooth,
                part, sky, side, light, cut, matrices, axis, valid, cells, columns, near, far,
                edges, multi_part, pixels):
    """Write the pixels with edges to the last three arguments; see EdgeFinder.

    Return the number of these pixels; if it exceeds the length of `pixels`, they are not listed.
    """
    find_corner_edges(tile, pixel, start, member, opaque, uniform, triangle, smooth, part, sky,
                      side, light, matrices, valid, cells, columns, edges, multi_part)
    _find_thin_edges(edges, multi_part, tile, pixel, start, member, full, pixel_masks, uniform,
                     triangle, smooth, sky, side, cut, matrices, axis, valid, cells, columns, near,
                     far)
    return _list_pixels(edges, cells, columns, pixels)
