"""Detection of the pixels whose corners show different surfaces."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import jit, jit_inline

from .shading import interpolate_light
from .tiles import BACKGROUND, NOTHING, SEVERAL, TILE

# Smallest contrast of an edge, grey levels. Smaller differences are treated as smooth shading. If
# an edge with less contrast is not found, the contour of a target with a contrast of 100 levels
# moves by at most a thirtieth of a pixel.
THRESHOLD = 6


@jit_inline
def has_contrast(a, b):
    """Return whether two packed colours differ by more than THRESHOLD."""
    apart = False
    for k in range(3):
        shift = np.uint32(8 * k)
        one = np.int32((a >> shift) & np.uint32(255))
        other = np.int32((b >> shift) & np.uint32(255))
        apart |= abs(one - other) > THRESHOLD
    return apart


@jit_inline
def _find_triangle_at(tile, pixel, columns, v, u):
    """Return the triangle at the sample in row v and column u; NOTHING outside the image."""
    if v < 0 or u < 0 or v >= pixel.shape[0] or u >= pixel.shape[1]:
        return np.int64(NOTHING)
    whole = tile[(v // TILE) * columns + u // TILE]
    return np.int64(pixel[v, u]) if whole == SEVERAL else whole


@jit("i8[::1], i4[:,::1], i8[::1], i8[::1], b1[::1], u4[::1], i8[::1], i8[::1], i8[::1], u4, "
          "f8[:,:,::1], f8[:,::1], f8[:,:,::1], b1[:,::1], i8, i8, u8[::1], u8[::1]")
def find_corner_edges(
    tile,
    pixel,
    start,
    member,
    opaque,
    uniform,
    triangle,
    smooth,
    part,
    sky,
    side,
    light,
    matrices,
    valid,
    cells,
    columns,
    edges,
    multi_part,
):
    """Find the pixels with edges from the samples at the pixel corners.

    The results are bit masks (tiles,). `edges` marks pixels whose corners show different surfaces,
    and all pixels of tiles with transparent triangles. `multi_part` marks pixels whose corners show
    several visuals.
    """
    size, side_of = TILE // cells, TILE + 1
    # Smallest and largest light at the three corners of each triangle.
    dim = np.empty((len(light), 2))
    for m in range(len(light)):
        dim[m, 0] = min(light[m, 0], light[m, 1], light[m, 2])
        dim[m, 1] = max(light[m, 0], light[m, 1], light[m, 2])
    shown = np.empty(side_of * side_of, np.int64)
    neighbours = np.empty(3, np.int64)
    for n in range(len(tile)):
        edges[n] = multi_part[n] = 0
        if tile[n] != SEVERAL:
            continue
        transparent = False
        for k in range(start[n], start[n + 1]):
            transparent |= not opaque[member[k]]
        u0, v0 = TILE * (n % columns), TILE * (n // columns)
        for y in range(TILE):
            for x in range(TILE):
                shown[y * side_of + x] = pixel[v0 + y, u0 + x]
        for k in range(side_of):
            shown[k * side_of + TILE] = _find_triangle_at(tile, pixel, columns, v0 + k, u0 + TILE)
            shown[TILE * side_of + k] = _find_triangle_at(tile, pixel, columns, v0 + TILE, u0 + k)
        bits = mixed = np.uint64(0)
        for y in range(TILE):
            for x in range(TILE):
                i = y * side_of + x
                m = shown[i]
                neighbours[0], neighbours[1], neighbours[2] = (
                    shown[i + 1],
                    shown[i + side_of],
                    shown[i + side_of + 1],
                )
                if (
                    m == neighbours[0]
                    and m == neighbours[1]
                    and m == neighbours[2]
                    and m != NOTHING
                    and not transparent
                ) or not valid[v0 + y, u0 + x]:
                    continue
                for k in range(3):
                    other = neighbours[k]
                    if other != m and (
                        other < 0 or m < 0 or part[triangle[other]] != part[triangle[m]]
                    ):
                        mixed |= np.uint64(1) << np.uint64(y * TILE + x)
                edge = transparent or m == NOTHING
                lit, known = 0.0, False
                rx = ry = rz = 0.0
                for k in range(3):
                    other = neighbours[k]
                    if edge or other == m or (k > 0 and other == neighbours[k - 1]):
                        continue
                    if other == NOTHING:
                        edge = True
                    elif m >= 0 and other >= 0 and 0 <= smooth[triangle[m]] == (
                        smooth[triangle[other]]
                    ):
                        # Within a visual that has no texture, colours differ only by the light.
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
                            lit, known = interpolate_light(side, light, m, rx, ry, rz), True
                        edge = abs(interpolate_light(side, light, other, rx, ry, rz) - lit
                                   ) > THRESHOLD / 255.0
                    else:
                        one = sky if m == BACKGROUND else uniform[m]
                        two = sky if other == BACKGROUND else uniform[other]
                        edge = one == 0 or two == 0 or has_contrast(one, two)
                if edge:
                    bits |= np.uint64(1) << np.uint64(y * TILE + x)
        edges[n], multi_part[n] = bits, mixed
