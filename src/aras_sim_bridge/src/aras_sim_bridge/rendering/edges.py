"""Pixels with edges in them, as exactly as geometry says.

A pixel with an edge is looked at as a square: each triangle in it is cut to the square, and what
others hide of it is cut away, all by straight lines. Its colour is that of the pieces that are
left, by their areas: there is nothing that samples could miss, and an edge is right wherever it
runs.
"""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import compiled, inlined

from .tiles import TILE

# Pixels with more triangles than this take FINE samples instead: the effort for areas grows
# with the square of the number.
CROWD = 4
FINE = 32
# The samples from the pixel's centre, px: each in a column and a row of its own, the rows by the
# bits of the column turned round (Hammersley's points).
SAMPLE_X = ((np.arange(FINE) + 0.5) / FINE - 0.5).astype(np.float32)
SAMPLE_Y = SAMPLE_X[[int(f"{n:05b}"[::-1], 2) for n in range(FINE)]]
CELL = TILE * TILE  # pixels, at most
# Relative difference in distance below which two triangles lie in one plane.
TOUCHING = 1e-8
# Room for the corners of a piece, and for pieces.
CORNERS, PIECES = 24, 64


@inlined
def _cut(shape, p, count, a, b, c, kept, rest):
    """Cut the convex polygon shape[p] (count corners) by the line a + b x + c y = 0: what is above
    becomes shape[kept], what is below shape[rest]; the numbers of their corners."""
    n_kept = n_rest = 0
    x, y = shape[p, count - 1, 0], shape[p, count - 1, 1]
    at = a + b * x + c * y
    for n in range(count):
        x2, y2 = shape[p, n, 0], shape[p, n, 1]
        at2 = a + b * x2 + c * y2
        if (at < 0.0) != (at2 < 0.0):
            share = at / (at - at2)
            xc, yc = x + share * (x2 - x), y + share * (y2 - y)
            shape[kept, n_kept, 0], shape[kept, n_kept, 1] = xc, yc
            shape[rest, n_rest, 0], shape[rest, n_rest, 1] = xc, yc
            n_kept += 1
            n_rest += 1
        if at2 < 0.0:
            shape[rest, n_rest, 0], shape[rest, n_rest, 1] = x2, y2
            n_rest += 1
        else:
            shape[kept, n_kept, 0], shape[kept, n_kept, 1] = x2, y2
            n_kept += 1
        x, y, at = x2, y2, at2
    return n_kept, n_rest


@inlined
def _area(polygon, p, count):
    """Area of the convex polygon p, either way round."""
    total = 0.0
    x, y = polygon[p, 0, 0], polygon[p, 0, 1]
    for n in range(2, count):
        total += ((polygon[p, n - 1, 0] - x) * (polygon[p, n, 1] - y)
                  - (polygon[p, n, 0] - x) * (polygon[p, n - 1, 1] - y))
    return abs(total) / 2.0


@compiled("f8[:,:,::1], i8[::1], i8, i8, f8[:,:,::1], i8[::1], f8[:,::1]")
def _visible(shape, sizes, i, count, line, lines, plane):
    """The area of polygon i that none of the first `count` polygons hides.

    line, lines, plane: the lines of each that cross the pixel, and one over its distance.
    """
    first, spare = CROWD, CROWD + PIECES
    end = first + 1
    sizes[first] = sizes[i]
    for n in range(sizes[i]):
        shape[first, n, 0], shape[first, n, 1] = shape[i, n, 0], shape[i, n, 1]
    for j in range(count):
        if j == i or sizes[j] == 0:
            continue
        # Where is j nearer than i?
        a = plane[j, 0] - plane[i, 0]
        b, c = plane[j, 1] - plane[i, 1], plane[j, 2] - plane[i, 2]
        low, high = np.inf, -np.inf
        for n in range(sizes[i]):
            at = a + b * shape[i, n, 0] + c * shape[i, n, 1]
            low, high = min(low, at), max(high, at)
        touching = TOUCHING * abs(plane[i, 0])
        if high <= touching and (low < -touching or j > i):
            continue
        crossing = low < -touching
        now, last = first, end
        while now < last:
            # Beside j if one of its lines has all of the piece below.
            beside = False
            for n in range(lines[j]):
                above = False
                for m in range(sizes[now]):
                    if (line[j, n, 0] + line[j, n, 1] * shape[now, m, 0]
                            + line[j, n, 2] * shape[now, m, 1] > 1e-12 * abs(line[j, n, 0])):
                        above = True
                        break
                if not above:
                    beside = True
                    break
            if beside:
                now += 1
                continue
            size, source = sizes[now], now
            for n in range(lines[j] + (1 if crossing else 0)):
                if n < lines[j]:
                    an, bn, cn = line[j, n, 0], line[j, n, 1], line[j, n, 2]
                else:
                    an, bn, cn = a, b, c
                goal = spare + n % 2
                size, below = _cut(shape, source, size, an, bn, cn, goal, end)
                source = goal
                # What finds no room is lost; there is room for far more than any pixel needed.
                if below > 2 and end < first + PIECES - 1:
                    sizes[end] = below
                    end += 1
                if size < 3:
                    break
            # The piece is gone: the last of those not looked at yet takes its place, and the last
            # of all takes that one's.
            last -= 1
            end -= 1
            for move in range(2):
                goal, other = (now, last) if move == 0 else (last, end)
                if goal != other:
                    sizes[goal] = sizes[other]
                    for m in range(sizes[other]):
                        shape[goal, m, 0] = shape[other, m, 0]
                        shape[goal, m, 1] = shape[other, m, 1]
    total = 0.0
    for n in range(first, end):
        total += _area(shape, n, sizes[n])
    return total


@compiled("i8, i8[::1], i8, i8, i8[::1], f8[:,:,::1], i8[::1], f8[:,::1], f8, f8, f4[::1], "
          "f4[::1], i4[::1], i8[::1], f8[:,::1], i8, i8[::1], f8[::1], f8[:,::1]")
def _crowd(first, here, left, solid, member, line, lines, plane, xc, yc, depth, nearest, sample,
           shown, middle, count, out_member, out_share, out_at):
    """Add fragments of a pixel by samples; the number of all fragments then.

    depth, nearest, sample: (FINE,) to work with; shown (.,), middle (., 2) likewise.
    """
    for i in range(FINE):
        nearest[i], sample[i] = 0.0, -1
    for n in range(left):
        k = here[n]
        # From the pixel's centre; lines that are not there are above everywhere.
        a0 = a1 = a2 = np.float32(1.0)
        b0 = b1 = b2 = c0 = c1 = c2 = np.float32(0.0)
        if lines[k] > 0:
            a0 = np.float32(line[k, 0, 0] + line[k, 0, 1] * xc + line[k, 0, 2] * yc)
            a1 = np.float32(line[k, 1, 0] + line[k, 1, 1] * xc + line[k, 1, 2] * yc)
            a2 = np.float32(line[k, 2, 0] + line[k, 2, 1] * xc + line[k, 2, 2] * yc)
            b0, c0 = np.float32(line[k, 0, 1]), np.float32(line[k, 0, 2])
            b1, c1 = np.float32(line[k, 1, 1]), np.float32(line[k, 1, 2])
            b2, c2 = np.float32(line[k, 2, 1]), np.float32(line[k, 2, 2])
        a = np.float32(plane[k, 0] + plane[k, 1] * xc + plane[k, 2] * yc)
        b, c = np.float32(plane[k, 1]), np.float32(plane[k, 2])
        for i in range(FINE):
            depth[i] = a + b * SAMPLE_X[i] + c * SAMPLE_Y[i]
        if lines[k] > 3:
            a3 = np.float32(line[k, 3, 0] + line[k, 3, 1] * xc + line[k, 3, 2] * yc)
            a4 = np.float32(line[k, 4, 0] + line[k, 4, 1] * xc + line[k, 4, 2] * yc)
            b3, c3 = np.float32(line[k, 3, 1]), np.float32(line[k, 3, 2])
            b4, c4 = np.float32(line[k, 4, 1]), np.float32(line[k, 4, 2])
            for i in range(FINE):
                x, y = SAMPLE_X[i], SAMPLE_Y[i]
                beyond = min(a3 + b3 * x + c3 * y, a4 + b4 * x + c4 * y) < np.float32(0.0)
                depth[i] = np.float32(0.0) if beyond else depth[i]
        name, hits = np.int32(n), 0
        for i in range(FINE):
            x, y = SAMPLE_X[i], SAMPLE_Y[i]
            hit = ((a0 + b0 * x + c0 * y >= np.float32(0.0))
                   & (a1 + b1 * x + c1 * y >= np.float32(0.0))
                   & (a2 + b2 * x + c2 * y >= np.float32(0.0)) & (depth[i] > nearest[i]))
            if n < solid:
                nearest[i] = depth[i] if hit else nearest[i]
                sample[i] = name if hit else sample[i]
            else:
                hits += hit
        if n >= solid and hits > 0:
            if count < len(out_member):
                out_member[count], out_share[count] = member[first + k], hits / FINE
                out_at[count, 0], out_at[count, 1] = xc, yc
            count += 1
        if n == solid - 1:
            for m in range(solid):
                shown[m], middle[m, 0], middle[m, 1] = 0, 0.0, 0.0
            for i in range(FINE):
                m = sample[i]
                if m >= 0:
                    shown[m] += 1
                    middle[m, 0] += SAMPLE_X[i]
                    middle[m, 1] += SAMPLE_Y[i]
            for m in range(solid):
                if shown[m] == 0:
                    continue
                if count < len(out_member):
                    out_member[count], out_share[count] = member[first + here[m]], shown[m] / FINE
                    out_at[count, 0] = xc + middle[m, 0] / shown[m]
                    out_at[count, 1] = yc + middle[m, 1] / shown[m]
                count += 1
    return count


@compiled("i8[::1], i8[::1], i8[::1], b1[::1], u8[::1], f8[:,:,::1], b1[::1], b1[::1], u4[::1], "
          "f8[:,:,::1], f8[:,::1], i8, i8, f8, f8, i8[::1], i8[::1], f8[::1], f8[:,::1]")
def resolved(found, start, member, full, touched, side, cut, opaque, plain, matrices, axis, cells,
             columns, near, far, out_start, out_member, out_share, out_at):
    """See fragments.Fragments; the number of fragments, of which as many are stored as there is
    room for."""
    size = TILE // cells
    width = columns * TILE
    longest = 1
    for n in range(len(start) - 1):
        longest = max(longest, start[n + 1] - start[n])
    # Of a cell's triangles: their lines a + b x + c y, and one over the distance likewise.
    line, lines = np.empty((longest, 5, 3)), np.empty(longest, np.int64)
    plane = np.empty((longest, 3))
    # Of a cell's pixels: where they are, the triangles in them, and of those that fill one the
    # nearest, which hides what is behind it.
    x_of, y_of, bit_of = np.empty(CELL), np.empty(CELL), np.empty(CELL, np.uint64)
    reach, bit = np.empty(5), np.uint64(1)
    here_of, left_of = np.empty((CELL, longest), np.int64), np.empty(CELL, np.int64)
    best_of, top_of = np.empty(CELL, np.int64), np.empty(CELL)
    here = np.empty(longest, np.int64)
    # Of those in a pixel, from its centre: the lines that cross it, and so on.
    own_line, own_lines = np.empty((CROWD, 5, 3)), np.empty(CROWD, np.int64)
    own_plane = np.empty((CROWD, 3))
    # Their polygons, pieces of those, and two more to work with.
    shape = np.empty((CROWD + PIECES + 2, CORNERS, 2))
    sizes = np.empty(CROWD + PIECES + 2, np.int64)
    spare = CROWD + PIECES
    nearest, sample = np.empty(FINE, np.float32), np.empty(FINE, np.int32)
    depth, shown, middle = np.empty(FINE, np.float32), np.empty(longest, np.int64), np.empty(
        (longest, 2))
    count = 0
    cell = group = end = first = 0
    for number in range(len(found)):
        if number == end:
            # The pixels found in the next cell, and the triangles in each of them.
            group = number
            wanted = np.uint64(0)
            while end < len(found):
                v, u = found[end] // width, found[end] % width
                tile, x0, y0 = (v // TILE) * columns + u // TILE, u % TILE, v % TILE
                at_cell = tile * cells * cells + (y0 // size) * cells + x0 // size
                if end > group and at_cell != cell:
                    break
                cell, first, q = at_cell, start[tile], end - group
                x_of[q], y_of[q] = float(x0 % size), float(y0 % size)
                bit_of[q] = np.uint64(y0 * TILE + x0)
                wanted |= bit << bit_of[q]
                left_of[q], best_of[q], top_of[q] = 0, -1, 0.0
                end += 1
            tile = cell // (cells * cells)
            for k in range(start[tile + 1] - first):
                bits = touched[first + k] & wanted
                if bits == 0:
                    continue
                m = member[first + k]
                lines[k] = 0 if full[first + k] else 5 if cut[m] else 3
                for j in range(3):
                    column = (j + 2) % 3  # the constant first
                    x, y = matrices[cell, 0, column], matrices[cell, 1, column]
                    z = matrices[cell, 2, column]
                    plane[k, j] = 0.0
                    for i in range(3):
                        line[k, i, j] = side[m, i, 0] * x + side[m, i, 1] * y + side[m, i, 2] * z
                        plane[k, j] += line[k, i, j]
                    if cut[m]:
                        along = axis[tile, 0] * x + axis[tile, 1] * y + axis[tile, 2] * z
                        line[k, 3, j] = along - near * plane[k, j]
                        line[k, 4, j] = far * plane[k, j] - along
                for i in range(lines[k]):
                    reach[i] = 0.5 * (abs(line[k, i, 1]) + abs(line[k, i, 2]))
                for q in range(end - group):
                    if (bits >> bit_of[q]) & bit == 0:
                        continue
                    x, y = x_of[q], y_of[q]
                    inside, fills = True, opaque[m]
                    for i in range(lines[k]):
                        at = line[k, i, 0] + line[k, i, 1] * x + line[k, i, 2] * y
                        inside &= at + reach[i] > 0.0
                        fills &= at >= reach[i]
                    if inside:
                        here_of[q, left_of[q]] = k
                        left_of[q] += 1
                        w = plane[k, 0] + plane[k, 1] * x + plane[k, 2] * y
                        if fills and w > top_of[q]:
                            best_of[q], top_of[q] = k, w
        q = number - group
        xc, yc, left, best, top = x_of[q], y_of[q], left_of[q], best_of[q], top_of[q]
        for n in range(left):
            here[n] = here_of[q, n]
        if best >= 0:
            some, left = left, 0
            for n in range(some):
                k = here[n]
                b, c = plane[best, 1] - plane[k, 1], plane[best, 2] - plane[k, 2]
                at = plane[best, 0] - plane[k, 0] + b * xc + c * yc
                if k == best or at - 0.5 * (abs(b) + abs(c)) < -TOUCHING * top:
                    here[left] = k
                    left += 1
        out_start[number] = count
        # Of one colour all over?
        same = best >= 0 and (left == 1 or plain[member[first + best]] != 0)
        for n in range(left):
            same = same and plain[member[first + here[n]]] == plain[member[first + best]]
        if same:
            if count < len(out_member):
                out_member[count], out_share[count] = member[first + best], 1.0
                out_at[count, 0], out_at[count, 1] = xc, yc
            count += 1
            continue
        # Opaque ones first, then those one sees through from far to near.
        solid = 0
        for n in range(left):
            if opaque[member[first + here[n]]]:
                here[solid], here[n] = here[n], here[solid]
                solid += 1
        for n in range(solid + 1, left):
            for m in range(n, solid, -1):
                one, other = here[m], here[m - 1]
                if (plane[other, 0] + plane[other, 1] * xc + plane[other, 2] * yc
                        <= plane[one, 0] + plane[one, 1] * xc + plane[one, 2] * yc):
                    break
                here[m], here[m - 1] = other, one
        if left > CROWD:
            count = _crowd(first, here, left, solid, member, line, lines, plane, xc, yc, depth,
                           nearest, sample, shown, middle, count, out_member, out_share, out_at)
            continue
        for n in range(left):
            k = here[n]
            own_plane[n, 0] = plane[k, 0] + plane[k, 1] * xc + plane[k, 2] * yc
            own_plane[n, 1], own_plane[n, 2] = plane[k, 1], plane[k, 2]
            for i in range(4):
                shape[n, i, 0] = 0.5 if i == 1 or i == 2 else -0.5
                shape[n, i, 1] = 0.5 if i > 1 else -0.5
            size_n, own_lines[n] = 4, 0
            for i in range(lines[k]):
                b, c = line[k, i, 1], line[k, i, 2]
                a = line[k, i, 0] + b * xc + c * yc
                if a >= 0.5 * (abs(b) + abs(c)):
                    continue  # the whole pixel is above
                j = own_lines[n]
                own_line[n, j, 0], own_line[n, j, 1], own_line[n, j, 2] = a, b, c
                own_lines[n] += 1
                size_n, _ = _cut(shape, n, size_n, a, b, c, spare, spare + 1)
                if size_n < 3:
                    size_n = 0
                    break
                for m in range(size_n):
                    shape[n, m, 0], shape[n, m, 1] = shape[spare, m, 0], shape[spare, m, 1]
            sizes[n] = size_n
        # What fills the pixel shows where nothing before it does.
        last = -1
        if best >= 0:
            for n in range(solid):
                if here[n] == best:
                    last = n
            for n in range(solid):
                if n != last:
                    b = own_plane[n, 1] - own_plane[last, 1]
                    c = own_plane[n, 2] - own_plane[last, 2]
                    if (own_plane[n, 0] - own_plane[last, 0]
                            < 0.5 * (abs(b) + abs(c)) - TOUCHING * top):
                        last = -1
                        break
        remaining = 1.0
        for turn in range(left):
            # The filling one after the other opaque ones.
            n = turn
            if last >= 0 and turn < solid:
                n = last if turn == solid - 1 else turn + (1 if turn >= last else 0)
            if sizes[n] == 0:
                continue
            share = remaining
            if n != last:
                share = _visible(shape, sizes, n, solid, own_line, own_lines, own_plane)
            if n < solid:
                remaining -= share
            if share <= 1e-9:
                continue
            if count < len(out_member):
                xm = ym = 0.0
                for m in range(sizes[n]):
                    xm += shape[n, m, 0]
                    ym += shape[n, m, 1]
                out_member[count], out_share[count] = member[first + here[n]], share
                out_at[count, 0] = xc + xm / sizes[n]
                out_at[count, 1] = yc + ym / sizes[n]
            count += 1
    out_start[len(found)] = count
    return count
