"""Areas that convex polygons cover in a pixel. The pixel is a unit square around the origin."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import jit, jit_inline

# Largest number of triangles in a pixel for which hidden areas are cut off exactly. The time grows
# with the square of this number. If a pixel contains more triangles, their visibility is sampled.
DENSE = 4
# Two triangles are treated as coplanar if their inverse distances differ by less than this
# fraction.
COPLANAR_TOLERANCE = 1e-8
# Largest number of corners of a polygon, and largest number of pieces into which a polygon is cut.
CORNERS, PIECES = 24, 64
# Rows of the arrays `line`. Each row contains the coefficients a, b, c of a function a + b x + c y
# of a pixel position. Up to LINES rows belong to the sides of a triangle; their functions are
# positive inside the triangle. The function of the row PLANE is the inverse distance of the
# triangle's plane.
LINES, PLANE = 5, 5


@jit_inline
def half_plane_area(a, b, c):
    """Return the area of the pixel where a + b x + c y > 0; b and c must not both be 0."""
    p, q = abs(b), abs(c)
    p, q = max(p, q), min(p, q)
    q = max(q, 1e-7 * p)  # avoids a division by 0; changes the area by less than 1e-7
    s = a + 0.5 * (p + q)
    s0, s1, s2, s3 = max(s, 0.0), max(s - p, 0.0), max(s - q, 0.0), max(s - p - q, 0.0)
    return (s0 * s0 - s1 * s1 - s2 * s2 + s3 * s3) / (2.0 * p * q)


@jit_inline
def _cut(shape, p, count, a, b, c, above, below):
    """Split the convex polygon shape[p] with `count` corners along the line a + b x + c y = 0.

    The part with a + b x + c y >= 0 is written to shape[above], the other part to shape[below].
    Return the numbers of corners of both parts.
    """
    n_kept = n_rest = 0
    x, y = shape[p, count - 1, 0], shape[p, count - 1, 1]
    at = a + b * x + c * y
    for n in range(count):
        x2, y2 = shape[p, n, 0], shape[p, n, 1]
        at2 = a + b * x2 + c * y2
        if (at < 0.0) != (at2 < 0.0):
            share = at / (at - at2)
            xc, yc = x + share * (x2 - x), y + share * (y2 - y)
            shape[above, n_kept, 0], shape[above, n_kept, 1] = xc, yc
            shape[below, n_rest, 0], shape[below, n_rest, 1] = xc, yc
            n_kept += 1
            n_rest += 1
        if at2 < 0.0:
            shape[below, n_rest, 0], shape[below, n_rest, 1] = x2, y2
            n_rest += 1
        else:
            shape[above, n_kept, 0], shape[above, n_kept, 1] = x2, y2
            n_kept += 1
        x, y, at = x2, y2, at2
    return n_kept, n_rest


@jit_inline
def polygon_area(polygon, p, count):
    """Return the area of the convex polygon p, with corners clockwise or anticlockwise."""
    total = 0.0
    x, y = polygon[p, 0, 0], polygon[p, 0, 1]
    for n in range(2, count):
        total += ((polygon[p, n - 1, 0] - x) * (polygon[p, n, 1] - y)
                  - (polygon[p, n, 0] - x) * (polygon[p, n - 1, 1] - y))
    return abs(total) / 2.0


@jit("f8[:,:,::1], i8, f8[:,:,::1], i8, i8, i8")
def clip_pixel(shape, goal, line, n, lines, spare):
    """Clip the pixel to the positive side of the lines line[n, :lines].

    The result is written to shape[goal]; shape[spare] and shape[spare + 1] are work space. Return
    the number of corners of the result, which is 0 if nothing remains.
    """
    for i in range(4):
        shape[goal, i, 0] = 0.5 if i == 1 or i == 2 else -0.5
        shape[goal, i, 1] = 0.5 if i > 1 else -0.5
    size, source = 4, goal
    for i in range(lines):
        a, b, c = line[n, i, 0], line[n, i, 1], line[n, i, 2]
        target = goal if source == spare else spare
        kept = 0
        x, y = shape[source, size - 1, 0], shape[source, size - 1, 1]
        at = a + b * x + c * y
        for k in range(size):
            x2, y2 = shape[source, k, 0], shape[source, k, 1]
            at2 = a + b * x2 + c * y2
            if (at < 0.0) != (at2 < 0.0):
                share = at / (at - at2)
                shape[target, kept, 0] = x + share * (x2 - x)
                shape[target, kept, 1] = y + share * (y2 - y)
                kept += 1
            if at2 >= 0.0:
                shape[target, kept, 0], shape[target, kept, 1] = x2, y2
                kept += 1
            x, y, at = x2, y2, at2
        size, source = kept, target
        if size < 3:
            return 0
    if source != goal:
        for k in range(size):
            shape[goal, k, 0], shape[goal, k, 1] = shape[source, k, 0], shape[source, k, 1]
    return size



@jit("f8[:,:,::1], i8[::1], i8, i8, f8[:,:,::1], i8[::1]")
def visible_area(shape, sizes, i, count, line, lines):
    """Return the area of polygon i that none of the first `count` polygons hides.

    A polygon hides another one where its plane is nearer to the camera. line[k] contains the sides
    and the inverse distance of polygon k (see LINES); lines[k] is the number of its sides.
    """
    first, spare = DENSE, DENSE + PIECES
    end = first + 1
    sizes[first] = sizes[i]
    for n in range(sizes[i]):
        shape[first, n, 0], shape[first, n, 1] = shape[i, n, 0], shape[i, n, 1]
    for j in range(count):
        if j == i or sizes[j] == 0:
            continue
        # The function a + b x + c y is positive where the plane of triangle j is nearer to the
        # camera than that of triangle i.
        a = line[j, PLANE, 0] - line[i, PLANE, 0]
        b, c = line[j, PLANE, 1] - line[i, PLANE, 1], line[j, PLANE, 2] - line[i, PLANE, 2]
        low, high = np.inf, -np.inf
        for n in range(sizes[i]):
            at = a + b * shape[i, n, 0] + c * shape[i, n, 1]
            low, high = min(low, at), max(high, at)
        touching = COPLANAR_TOLERANCE * abs(line[i, PLANE, 0])
        if high <= touching and (low < -touching or j > i):
            continue
        crossing = low < -touching
        now, last = first, end
        while now < last:
            # A piece of triangle i is outside triangle j if the whole piece is on the negative side
            # of one of j's lines.
            outside = False
            for n in range(lines[j]):
                above = False
                for m in range(sizes[now]):
                    if (line[j, n, 0] + line[j, n, 1] * shape[now, m, 0]
                            + line[j, n, 2] * shape[now, m, 1] > 1e-12 * abs(line[j, n, 0])):
                        above = True
                        break
                if not above:
                    outside = True
                    break
            if outside:
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
                # Pieces beyond the capacity PIECES are dropped. In tests, no pixel has needed
                # nearly as many.
                if below > 2 and end < first + PIECES - 1:
                    sizes[end] = below
                    end += 1
                if size < 3:
                    break
            # Remove the piece `now`, which triangle j hides: move the last unchecked piece to its
            # place, and the last of all pieces to the place that becomes free.
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
        total += polygon_area(shape, n, sizes[n])
    return total


@jit_inline
def polygon_mean(shape, p, count, middle, n):
    """Write the mean of polygon p's corners to middle[n]."""
    x = y = 0.0
    for k in range(count):
        x += shape[p, k, 0]
        y += shape[p, k, 1]
    share = 1.0 / max(count, 1)
    middle[n, 0], middle[n, 1] = share * x, share * y


@jit_inline
def find_crossing_lines(line, lines, k, x, y, own, n):
    """Write to own[n] those lines of triangle k that cross the pixel at x, y.

    The written lines are relative to the pixel centre. Return their number.
    """
    crossing = 0
    for i in range(lines[k]):
        b, c = line[k, i, 1], line[k, i, 2]
        a = line[k, i, 0] + b * x + c * y
        if a < 0.5 * (abs(b) + abs(c)):
            own[n, crossing, 0], own[n, crossing, 1], own[n, crossing, 2] = a, b, c
            crossing += 1
    b, c = line[k, PLANE, 1], line[k, PLANE, 2]
    own[n, PLANE, 0], own[n, PLANE, 1] = line[k, PLANE, 0] + b * x + c * y, b
    own[n, PLANE, 2] = c
    return crossing
