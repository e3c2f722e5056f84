"""Exact visible areas of the triangles in pixels with edges.

Each triangle is clipped to the square of the pixel, which gives the area that it covers. How the
visible part of this area is found depends on the pixel:

- Triangles of one convex visual that face the camera do not hide each other. If only such triangles
are in front of a triangle that fills the pixel, their whole areas are visible.
- Otherwise, if there are few triangles, the hidden areas are cut off along straight lines.
- If there are many triangles, the visible fraction of each area is estimated from samples.
"""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import jit, jit_inline

from .dense_coverage import FINE, compute_sample_mean, integrate_rows, is_hidden, sample_pixel
from .polygon_areas import (
    COPLANAR_TOLERANCE,
    CORNERS,
    DENSE,
    LINES,
    PIECES,
    PLANE,
    clip_pixel,
    find_crossing_lines,
    half_plane_area,
    polygon_area,
    polygon_mean,
    visible_area,
)
from .tiles import TILE

# A sliver is a triangle that is thinner than about 1 / SLIVER px. Slivers are not sampled, because
# a sample represents a larger area, 1 / FINE of the pixel, than a sliver covers. At a sample, a
# sliver therefore hides no other triangle.
SLIVER = 64.0
# A triangle that covers no sample is ignored if its area is smaller than this part of a pixel. This
# changes a grey level by at most 0.1.
SMALLEST_SHARE = 4e-4
CELL = TILE * TILE  # largest number of pixels of a tile that have the same pinhole model (a cell)
# Rows of the array `work`, which has one column for each pixel: position of the pixel (X, Y); index
# of the nearest triangle that fills the pixel (BEST, -1 if there is none); inverse distance of this
# triangle (TOP) and its change per pixel (TOP_X, TOP_Y).
X, Y, TOP, TOP_X, TOP_Y, BEST = range(6)


@jit_inline
def _is_before(corner, side, m, other):
    """Return whether the whole triangle m is in front of the plane of the triangle `other`."""
    before = True
    for k in range(3):
        at = 0.0
        for j in range(3):
            at += (side[other, 0, j] + side[other, 1, j] + side[other, 2, j]) * corner[m, k, j]
        before &= at <= 1.0 + COPLANAR_TOLERANCE
    return before


@jit("i8[::1], i8[::1], i8[::1], b1[::1], u8[::1], f8[:,:,::1], f8[:,:,::1], "
          "b1[::1], b1[::1], u4[::1], i8[::1], i8[::1], f8[:,:,::1], f8[:,::1], i8, i8, f8, f8, "
          "i8[::1], i8[::1], f8[::1], f8[:,::1]")
def resolve_fragments(
    edge_pixels,
    start,
    member,
    full,
    pixel_masks,
    corner,
    side,
    cut,
    opaque,
    uniform,
    triangle,
    hull,
    matrices,
    axis,
    cells,
    columns,
    near,
    far,
    out_start,
    out_member,
    out_share,
    out_at,
):
    """Compute the visible parts (fragments) of the triangles in pixels with edges.

    The result is written to out_start, out_member, out_share and out_at, the arrays of
    fragments.Fragments. Return the number of fragments; those beyond the capacity of the arrays are
    counted but not stored.
    """
    size = TILE // cells
    width = columns * TILE
    longest = 1
    for n in range(len(start) - 1):
        longest = max(longest, start[n + 1] - start[n])
    # For each triangle of a cell, which is a part of a tile with one pinhole model: coefficients of
    # its sides and inverse distance (see polygon_areas.LINES), relative to the cell's first pixel.
    line, lines = np.empty((longest, LINES + 1, 3)), np.empty(longest, np.int64)
    inside, sliver = np.empty((longest, CELL)), np.empty(longest, np.bool_)
    # One array for all values of the pixels: the compiler knows that its rows do not overlap, and
    # can vectorise loops over them.
    work = np.empty((6, CELL))
    bit_of, one = np.empty(CELL, np.uint64), np.uint64(1)
    # For each pixel of a cell: indices of the triangles that reach into the pixel, and their
    # number.
    here_of, left_of = np.empty((CELL, longest + 1), np.int64), np.empty(CELL, np.int64)
    here = np.empty(longest + 1, np.int64)
    # For each triangle of a pixel: coefficients of its sides and inverse distance, relative to the
    # pixel centre.
    own, own_lines = np.empty((DENSE, LINES + 1, 3)), np.empty(DENSE, np.int64)
    shape = np.empty((DENSE + PIECES + 2, CORNERS, 2))
    sizes = np.empty(DENSE + PIECES + 2, np.int64)
    spare = DENSE + PIECES
    samples = np.empty((3, FINE), np.float32)
    counts, shares = np.empty((longest, 2)), np.empty(longest)
    middle = np.empty((longest, 2))
    count = 0
    cell = group = end = first = 0
    for number in range(len(edge_pixels)):
        if number == end:
            # Collect the pixels of the next cell of the image's grid, and for each pixel the
            # triangles that reach into it.
            group = number
            pixel_bits = np.uint64(0)
            while end < len(edge_pixels):
                v, u = edge_pixels[end] // width, edge_pixels[end] % width
                tile, x0, y0 = (v // TILE) * columns + u // TILE, u % TILE, v % TILE
                at_cell = tile * cells * cells + (y0 // size) * cells + x0 // size
                if end > group and at_cell != cell:
                    break
                cell, first, q = at_cell, start[tile], end - group
                work[X, q], work[Y, q] = float(x0 % size), float(y0 % size)
                work[TOP, q], work[TOP_X, q], work[TOP_Y, q], work[BEST, q] = 0.0, 0.0, 0.0, -1.0
                bit_of[q] = np.uint64(y0 * TILE + x0)
                pixel_bits |= one << bit_of[q]
                left_of[q] = 0
                end += 1
            tile, pixels = cell // (cells * cells), end - group
            length = 0.0  # squared length of the ray through the cell's first pixel
            for j in range(3):
                length += matrices[cell, j, 2]**2
            for k in range(start[tile + 1] - first):
                if pixel_masks[first + k] & pixel_bits == 0:
                    continue
                m = member[first + k]
                lines[k] = 0 if full[first + k] else 5 if cut[m] else 3
                for j in range(3):
                    # the columns of `line` are the constant, the factor of x and the factor of y
                    column = (j + 2) % 3
                    x, y = matrices[cell, 0, column], matrices[cell, 1, column]
                    z = matrices[cell, 2, column]
                    for i in range(3):
                        line[k, i, j] = side[m, i, 0] * x + side[m, i, 1] * y + side[m, i, 2] * z
                    line[k, PLANE, j] = line[k, 0, j] + line[k, 1, j] + line[k, 2, j]
                    if cut[m]:
                        along = axis[tile, 0] * x + axis[tile, 1] * y + axis[tile, 2] * z
                        line[k, 3, j] = along - near * line[k, PLANE, j]
                        line[k, 4, j] = far * line[k, PLANE, j] - along
                # Find slivers: the faster the function of a side changes per pixel, the thinner is
                # the triangle.
                steep, nearest = 0.0, np.inf
                for i in range(3):
                    steep = max(steep, abs(line[k, i, 1]) + abs(line[k, i, 2]))
                    nearest = min(nearest, corner[m, i, 0]**2 + corner[m, i, 1]**2
                                  + corner[m, i, 2]**2)
                sliver[k] = steep * steep * nearest > SLIVER * SLIVER * length
                for q in range(pixels):
                    inside[k, q] = np.inf
                for i in range(lines[k]):
                    a, b, c = line[k, i, 0], line[k, i, 1], line[k, i, 2]
                    # Scale the coefficients of the side, so that its value at a pixel centre tells
                    # where the whole pixel is: outside the side if the value is <= -1, inside if it
                    # is >= 1.
                    scale = 2.0 / max(abs(b) + abs(c), 1e-300)
                    a, b, c = a * scale, b * scale, c * scale
                    for q in range(pixels):
                        above = a + b * work[X, q] + c * work[Y, q]
                        inside[k, q] = above if above < inside[k, q] else inside[k, q]
                a, b, c = line[k, PLANE, 0], line[k, PLANE, 1], line[k, PLANE, 2]
                name, hides = float(k), opaque[m]
                for q in range(pixels):
                    w = a + b * work[X, q] + c * work[Y, q]
                    fills = hides & (inside[k, q] >= 1.0) & (w > work[TOP, q])
                    work[TOP, q] = w if fills else work[TOP, q]
                    work[TOP_X, q] = b if fills else work[TOP_X, q]
                    work[TOP_Y, q] = c if fills else work[TOP_Y, q]
                    work[BEST, q] = name if fills else work[BEST, q]
            for k in range(start[tile + 1] - first):
                bits = pixel_masks[first + k] & pixel_bits
                if bits == 0:
                    continue
                a, b, c = line[k, PLANE, 0], line[k, PLANE, 1], line[k, PLANE, 2]
                name = float(k)
                for q in range(pixels):
                    # Test whether a part of the triangle in this pixel is in front of the triangle
                    # that fills the pixel.
                    ahead = a + b * work[X, q] + c * work[Y, q] - work[TOP, q] + 0.5 * (
                        abs(b - work[TOP_X, q]) + abs(c - work[TOP_Y, q]))
                    reaches = (inside[k, q] > -1.0) & ((ahead > COPLANAR_TOLERANCE * work[TOP, q])
                                                     | (work[BEST, q] == name))
                    inside[k, q] = 1.0 if reaches else 0.0
                for q in range(pixels):
                    here_of[q, left_of[q]] = k
                    left_of[q] += np.int64(inside[k, q]) & np.int64(bits >> bit_of[q] & one)
        q = number - group
        xc, yc, left, best = work[X, q], work[Y, q], left_of[q], int(work[BEST, q])
        out_start[number] = count
        # Find out whether the whole pixel has one colour, and move the opaque triangles to the
        # front of the pixel's list.
        colour = uniform[member[first + best]] if best >= 0 else np.uint32(0)
        same = best >= 0 and (left == 1 or colour != 0)
        solid, last = 0, -1
        for n in range(left):
            k = here_of[q, n]
            here[n] = k
            m = member[first + k]
            same = same and uniform[m] == colour
            if opaque[m]:
                here[solid], here[n] = k, here[solid]
                if k == best:
                    last = solid
                solid += 1
        if same:
            if count < len(out_member):
                out_member[count], out_share[count] = member[first + best], 1.0
                out_at[count, 0], out_at[count, 1] = xc, yc
            count += 1
            continue
        for n in range(solid + 1, left):
            for m in range(n, solid, -1):
                k, other = here[m], here[m - 1]
                if (line[other, PLANE, 0] + line[other, PLANE, 1] * xc + line[other, PLANE, 2] * yc
                        <= line[k, PLANE, 0] + line[k, PLANE, 1] * xc + line[k, PLANE, 2] * yc):
                    break
                here[m], here[m - 1] = other, k
        # Test whether all triangles in front of the one that fills the pixel belong to the same
        # convex visual.
        one_part, convex, top = solid == left, np.int64(-2), work[TOP, q]
        for n in range(left):
            k = here[n]
            middle[n, 0] = middle[n, 1] = 0.0
            if k == best:
                continue
            m = member[first + k]
            if n < solid and last >= 0:
                b, c = line[k, PLANE, 1], line[k, PLANE, 2]
                ahead = line[k, PLANE, 0] + b * xc + c * yc - top - 0.5 * (
                    abs(b - work[TOP_X, q]) + abs(c - work[TOP_Y, q]))
                # `last` is only valid if every other triangle is in front of the one that fills the
                # pixel, in this pixel or as a whole.
                if ahead < -COPLANAR_TOLERANCE * top and not _is_before(
                    corner, side, m, member[first + best]
                ):
                    last = -1
            own_hull = hull[triangle[m]] if one_part else -1
            convex = own_hull if convex == -2 else convex
            one_part = one_part and (own_hull == convex and own_hull >= 0 or left == 1)
        one_part = one_part and (best < 0 or last >= 0)
        total, visible_count, is_sampled, many = 0.0, 0.0, False, left > DENSE
        if not many and not one_part:
            for n in range(left):
                own_lines[n] = find_crossing_lines(line, lines, here[n], xc, yc, own, n)
                sizes[n] = clip_pixel(shape, n, own, n, own_lines[n], spare)
                polygon_mean(shape, n, sizes[n], middle, n)
            for n in range(left):
                shares[n] = 0.0
                if sizes[n] > 0 and n != last:
                    shares[n] = visible_area(shape, sizes, n, solid, own, own_lines)
                    total += shares[n] if n < solid else 0.0
        else:
            farthest = 0.0
            if many:
                farthest = sample_pixel(
                    here, line, lines, sliver, xc, yc, left, solid, samples, counts
                )
                for n in range(solid):
                    visible_count += counts[n, 1] if n != last else 0.0
            # If the triangles of one convex visual cover all samples of the pixel, the area of a
            # triangle is the fraction of the samples that show it.
            is_filled = one_part and visible_count == FINE
            for n in range(left):
                if n == last:
                    continue
                hits, shown, shares[n], k = counts[n, 0], counts[n, 1], 0.0, here[n]
                if is_filled:
                    if shown > 0.0:
                        shares[n], is_sampled = shown / FINE, True
                        total += shares[n]
                        compute_sample_mean(samples, n, shown, middle)
                    continue
                b, c = line[k, PLANE, 1], line[k, PLANE, 2]
                if many and shown == 0.0 and (hits > 0.0 or line[k, PLANE, 0] + b * xc + c * yc
                                              + 0.5 * (abs(b) + abs(c)) < farthest):
                    continue
                crossing = find_crossing_lines(line, lines, k, xc, yc, own, 0)
                if crossing == 0:
                    shares[n] = 1.0
                elif crossing == 1:
                    a, b, c = own[0, 0, 0], own[0, 0, 1], own[0, 0, 2]
                    shares[n] = half_plane_area(a, b, c)
                    # With a < 0, the only side that crosses the pixel leaves less than half of it
                    # inside the triangle. The fragment's centre is then midway between this side
                    # and the pixel corner that is farthest inside.
                    if a < 0.0:
                        back = a / (b * b + c * c)
                        middle[n, 0] = 0.5 * ((0.5 if b > 0.0 else -0.5) - back * b)
                        middle[n, 1] = 0.5 * ((0.5 if c > 0.0 else -0.5) - back * c)
                elif many:
                    shares[n] = integrate_rows(own, crossing, samples, middle, n)
                else:
                    sizes[0] = clip_pixel(shape, 0, own, 0, crossing, spare)
                    if sizes[0] > 0:
                        shares[n] = polygon_area(shape, 0, sizes[0])
                        polygon_mean(shape, 0, sizes[0], middle, n)
                if many and not one_part:
                    if hits > 0.0:
                        shares[n] *= shown / hits
                        is_sampled |= shown < hits
                    elif shares[n] < SMALLEST_SHARE or is_hidden(
                        here, line, lines, counts, n, solid, xc + middle[n, 0], yc + middle[n, 1]
                    ):
                        shares[n] = 0.0
                total += shares[n] if n < solid else 0.0
        scale = 1.0
        if last >= 0:
            shares[last] = max(1.0 - total, 0.0)
        if total > 1.0 or (last < 0 and (best >= 0 or (is_sampled and visible_count == FINE))):
            scale = 1.0 / total
        for n in range(left):
            if shares[n] <= 1e-9:
                continue
            if count < len(out_member):
                out_member[count] = member[first + here[n]]
                out_share[count] = shares[n] * scale if n < solid else shares[n]
                out_at[count, 0], out_at[count, 1] = xc + middle[n, 0], yc + middle[n, 1]
            count += 1
    out_start[len(edge_pixels)] = count
    return count
