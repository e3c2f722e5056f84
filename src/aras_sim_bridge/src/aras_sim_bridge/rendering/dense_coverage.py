"""Visible areas of triangles in pixels with many triangles.

The visible area of a triangle is the covered area times the visible fraction of the covered area.
The covered area is integrated along rows; the fraction is estimated from samples.
"""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import jit_inline, jit_inline_numba

from .polygon_areas import COPLANAR_TOLERANCE, PLANE

# Number of samples in a pixel that contains more than polygon_areas.DENSE triangles.
FINE = 32
# The widths of a triangle in the rows of a pixel are rounded to multiples of 1 / UNIT px. Their sum
# then does not depend on the order of the summands.
UNIT = 1 << 20
# Positions of the samples relative to the pixel centre, px. The pixel is divided into FINE columns
# and FINE rows; sample n is in column n and row SAMPLE_ROW[n]. SAMPLE_ROW reverses the five bits of
# n (Hammersley points).
SAMPLE_X = ((np.arange(FINE) + 0.5) / FINE - 0.5).astype(np.float32)
SAMPLE_ROW = np.array([int(f"{n:05b}"[::-1], 2) for n in range(FINE)], np.int32)
SAMPLE_Y = SAMPLE_X[SAMPLE_ROW]


@jit_inline_numba
def sample_pixel(triangles, line, lines, sliver, x0, y0, count, opaque_count, work, counts):
    """Count the samples of a pixel that each triangle covers, and those where it is visible.

    A sliver, which is a triangle thinner than 1 / visible_areas.SLIVER px, is not sampled.

    Args:
        x0, y0: position of the pixel.
        count: number of triangles.
        opaque_count: number of opaque triangles, which are the first ones.
        work: (3, FINE) float32, work space.
        counts: (., 2) receives, for each triangle, the number of samples that it covers, or -1 for
            a sliver, and the number of samples where it is visible.

    Returns:
        Smallest inverse distance of the opaque triangles that are visible at the samples.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    for i in range(FINE):
        # inverse distance and index of a sample's nearest triangle
        work[0, i], work[2, i] = zero, -one
    for n in range(count):
        k = triangles[n]
        counts[n, 0] = counts[n, 1] = 0.0
        a0 = a1 = a2 = one  # a triangle that no line bounds fills the pixel
        b0 = b1 = b2 = c0 = c1 = c2 = zero
        if sliver[k]:
            counts[n, 0] = -1.0
            continue
        if lines[k] > 0:
            b0, c0 = np.float32(line[k, 0, 1]), np.float32(line[k, 0, 2])
            b1, c1 = np.float32(line[k, 1, 1]), np.float32(line[k, 1, 2])
            b2, c2 = np.float32(line[k, 2, 1]), np.float32(line[k, 2, 2])
            a0 = np.float32(line[k, 0, 0] + line[k, 0, 1] * x0 + line[k, 0, 2] * y0)
            a1 = np.float32(line[k, 1, 0] + line[k, 1, 1] * x0 + line[k, 1, 2] * y0)
            a2 = np.float32(line[k, 2, 0] + line[k, 2, 1] * x0 + line[k, 2, 2] * y0)
        a = np.float32(line[k, PLANE, 0] + line[k, PLANE, 1] * x0 + line[k, PLANE, 2] * y0)
        b, c = np.float32(line[k, PLANE, 1]), np.float32(line[k, PLANE, 2])
        index, hits, visible = np.float32(n), np.int32(0), np.int32(0)
        if n < opaque_count and lines[k] <= 3:
            for i in range(FINE):
                x, y = SAMPLE_X[i], SAMPLE_Y[i]
                l0, l1, l2 = a0 + b0 * x + c0 * y, a1 + b1 * x + c1 * y, a2 + b2 * x + c2 * y
                depth = a + b * x + c * y
                inside = (l0 >= zero) & (l1 >= zero) & (l2 >= zero)
                in_front = inside & (depth > work[0, i])
                work[1, i] = one if inside else zero
                work[0, i] = depth if in_front else work[0, i]
                work[2, i] = index if in_front else work[2, i]
        else:
            for i in range(FINE):
                x, y = SAMPLE_X[i], SAMPLE_Y[i]
                inside = min(a0 + b0 * x + c0 * y, a1 + b1 * x + c1 * y, a2 + b2 * x + c2 * y)
                for j in range(3, lines[k]):
                    inside = min(inside, np.float32(line[k, j, 0] + line[k, j, 1] * (x0 + x)
                                                  + line[k, j, 2] * (y0 + y)))
                depth = a + b * x + c * y
                work[1, i] = one if inside >= zero else zero
                if inside >= zero and depth > work[0, i]:
                    visible += np.int32(1)
                    if n < opaque_count:
                        work[0, i], work[2, i] = depth, index
        for i in range(FINE):
            hits += np.int32(work[1, i] == one)
        counts[n, 0], counts[n, 1] = hits, visible
    for n in range(opaque_count):
        index, visible = np.float32(n), np.int32(0)
        for i in range(FINE):
            visible += np.int32(work[2, i] == index)
        counts[n, 1] = visible
    half = FINE // 2
    while half > 0:
        for i in range(half):
            other = work[0, i + half]
            work[0, i] = other if other < work[0, i] else work[0, i]
        half //= 2
    return work[0, 0]


@jit_inline
def compute_sample_mean(work, n, visible_count, middle):
    """Write to middle[n] the mean position of the samples where triangle n is visible."""
    name, x, y = np.float32(n), np.int32(0), np.int32(0)
    for i in range(FINE):
        x += np.int32(work[2, i] == name) * np.int32(i)
        y += np.int32(work[2, i] == name) * np.int32(SAMPLE_ROW[i])
    middle[n, 0] = (x / visible_count + 0.5) / FINE - 0.5
    middle[n, 1] = (y / visible_count + 0.5) / FINE - 0.5


@jit_inline_numba
def integrate_rows(own, lines, work, middle, n):
    """Return the area of a pixel on the positive side of the lines own[0, :lines].

    The pixel is divided into FINE rows, or into FINE columns if the area is thinner along y than
    along x. The result is the mean of the exact widths of the area in these rows or columns. The
    centre of the area is written to middle[n]. `work` (3, FINE) float32 is work space.
    """
    across = down = 0.0
    for k in range(lines):
        across += abs(own[0, k, 1])
        down += abs(own[0, k, 2])
    i, j = (1, 2) if across >= down else (2, 1)
    half, zero, unit = np.float32(0.5), np.float32(0.0), np.float32(UNIT)
    for r in range(FINE):
        work[0, r], work[1, r] = -half, half
    for k in range(lines):
        b, c = own[0, k, i], own[0, k, j]
        b = b if abs(b) > 1e-9 * abs(c) else 1e-9 * abs(c)
        a, c = np.float32(-own[0, k, 0] / b), np.float32(-c / b)
        if b > 0.0:
            for r in range(FINE):
                at = a + c * SAMPLE_X[r]
                work[0, r] = at if at > work[0, r] else work[0, r]
        else:
            for r in range(FINE):
                at = a + c * SAMPLE_X[r]
                work[1, r] = at if at < work[1, r] else work[1, r]
    total, at, row = np.int32(0), np.int32(0), np.int32(0)
    for r in range(FINE):
        wide = max(work[1, r] - work[0, r], zero)
        part = np.int32(wide * unit)
        total += part
        row += part * np.int32(r)
        at += np.int32((work[1, r] + work[0, r]) * wide * unit)
    if total > 0:
        middle[n, i - 1] = 0.5 * at / total
        middle[n, j - 1] = (row / total + 0.5) / FINE - 0.5
    return total / (UNIT * FINE)


@jit_inline
def is_hidden(triangles, line, lines, counts, n, opaque_count, x, y):
    """Return whether one of the first `opaque_count` triangles hides triangle n at x, y.

    Slivers, which have -1 in `counts`, do not hide other triangles.
    """
    k = triangles[n]
    depth = line[k, PLANE, 0] + line[k, PLANE, 1] * x + line[k, PLANE, 2] * y
    hidden = False
    for other in range(opaque_count):
        k = triangles[other]
        if counts[other, 0] >= 0.0 and (
                line[k, PLANE, 0] + line[k, PLANE, 1] * x + line[k, PLANE, 2] * y
                > depth * (1.0 + COPLANAR_TOLERANCE)):
            i = 0
            while i < lines[k] and line[k, i, 0] + line[k, i, 1] * x + line[k, i, 2] * y > 0.0:
                i += 1
            if i == lines[k]:
                hidden = True
                break
    return hidden
