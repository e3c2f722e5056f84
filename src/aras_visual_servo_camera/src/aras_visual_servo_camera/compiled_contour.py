"""Compiled loops of the module `contour`.

They locate the points of an outline with sub-pixel accuracy, and fit lines to its sides.
"""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import jit

from .edge_pixels import compute_gradient
from .intersection_accuracy import PARALLEL

MAX_CORNERS = 32
# Smallest slope of the coverage (part of a pixel that the target covers) at an outline, 1/px. An
# edge with a smaller slope is too blurred to be located.
MIN_SLOPE = 0.05
# The coverage (fraction of a pixel that the target covers) is integrated along the normal of the
# edge, from -REACH to REACH px, over STEPS intervals of STEP px.
STEPS, STEP, REACH = 16, 0.25, 2.0
MAX_OFFSET = 1.5  # px


@jit("f8[:,::1], i4[:,:], f8[:,::1]", allocates=False)
def locate_edge(weights, edge, found):
    """Locate the target's edge next to the pixels of its outline.

    The coverage, i.e. the fraction of a pixel that the target covers, is integrated along the
    normal of the edge. The path leads from two pixels inside the target, where the coverage is one,
    to two pixels outside, where it is zero. The integral is the length of the path inside the
    target, even if the edge is blurred by a symmetric kernel.

    Args:
        weights: (rows, columns) coverage.
        edge: (n, 2) column and row of the pixels along the outline.
        found: (n, 2) array to which the columns and rows of the located points are written. Pixels
            where the coverage changes too little are omitted.

    Returns:
        Number of located points.
    """
    rows, columns = weights.shape
    count = 0
    for n in range(len(edge)):
        u, v = edge[n, 0], edge[n, 1]
        gx, gy = compute_gradient(weights, v, u)
        gx, gy = gx / 8.0, gy / 8.0  # slope of the coverage along u and v, 1/px
        slope = np.sqrt(gx * gx + gy * gy)
        if not slope > MIN_SLOPE:
            continue
        nx, ny = -gx / slope, -gy / slope  # outward normal
        covered = 0.0
        for k in range(STEPS + 1):
            at = k * STEP - REACH
            # Bilinear interpolation between pixels. Beyond the border of the image, the values of
            # the border continue. Positions have single precision, as in cv2.remap.
            x, y = np.float32(u + nx * at), np.float32(v + ny * at)
            x0, y0 = int(np.floor(x)), int(np.floor(y))
            a, b = x - np.float32(x0), y - np.float32(y0)
            c0, c1 = min(max(x0, 0), columns - 1), min(max(x0 + 1, 0), columns - 1)
            r0, r1 = min(max(y0, 0), rows - 1), min(max(y0 + 1, 0), rows - 1)
            value = (1.0 - b) * ((1.0 - a) * weights[r0, c0] + a * weights[r0, c1]) + b * (
                (1.0 - a) * weights[r1, c0] + a * weights[r1, c1]
            )
            covered += 0.5 * value if k == 0 or k == STEPS else value
        out = min(max(STEP * covered - REACH, -MAX_OFFSET), MAX_OFFSET)
        found[count, 0], found[count, 1] = u + out * nx, v + out * ny
        count += 1
    return count


@jit("f8[:,:], f8[:,::1]")
def centre_polygon(polygon, points):
    """Write a polygon relative to its middle, clockwise in the image (y is down).

    Args:
        polygon: (n, 2) points.
        points: (n, 2) array to which the result is written.

    Returns:
        x and y of the polygon's middle; the median length of its sides; its perimeter.
    """
    count = len(polygon)
    x = y = area = 0.0
    for n in range(count):
        x += polygon[n, 0]
        y += polygon[n, 1]
    x, y = x / count, y / count
    lengths = np.empty(count)
    for n in range(count):
        after = n + 1 if n + 1 < count else 0
        px, py = polygon[n, 0] - x, polygon[n, 1] - y
        qx, qy = polygon[after, 0] - x, polygon[after, 1] - y
        area += px * qy - py * qx
        lengths[n] = np.sqrt((qx - px) ** 2 + (qy - py) ** 2)
    for n in range(count):
        target = n if area >= 0.0 else count - 1 - n
        points[target, 0], points[target, 1] = polygon[n, 0] - x, polygon[n, 1] - y
    total = 0.0
    for n in range(count):
        total += lengths[n]
    lengths.sort()
    return x, y, 0.5 * (lengths[(count - 1) // 2] + lengths[count // 2]), total


@jit("f8[:,::1], f8", allocates=False)
def merge_corners(corners, shortest):
    """Replace sides that are shorter than `shortest` by a corner in their middle.

    At least three corners remain.

    Args:
        corners: (n, 2) corners; the corners that remain are written to its first rows.
        shortest: length of the shortest side that remains.

    Returns:
        Number of corners that remain.
    """
    count = len(corners)
    while count > 3:
        first, length = 0, np.inf
        for n in range(count):
            after = n + 1 if n + 1 < count else 0
            dx, dy = corners[after, 0] - corners[n, 0], corners[after, 1] - corners[n, 1]
            if dx * dx + dy * dy < length:
                first, length = n, dx * dx + dy * dy
        if not np.sqrt(length) < shortest:
            break
        last = first + 1 if first + 1 < count else 0
        for k in range(2):
            corners[first, k] = 0.5 * (corners[first, k] + corners[last, k])
        for n in range(last, count - 1):
            corners[n, 0], corners[n, 1] = corners[n + 1, 0], corners[n + 1, 1]
        count -= 1
    return count


@jit("f8[:,::1], f8[:,:], i8[::1]", allocates=False)
def _find_breaks(points, corners, breaks):
    """Find the outline point that is nearest to each corner, without duplicates.

    Args:
        points: (m, 2) points of the closed outline.
        corners: (k, 2) corners.
        breaks: (k,) or longer array to which the indices of the points are written, in order along
            the outline, starting at the first corner.

    Returns:
        Number of indices; it is smaller than k if several corners have the same nearest point.
    """
    total, first, count = len(points), 0, 0
    for k in range(len(corners)):
        place, least = 0, np.inf
        for n in range(total):
            dx, dy = points[n, 0] - corners[k, 0], points[n, 1] - corners[k, 1]
            if dx * dx + dy * dy < least:
                place, least = n, dx * dx + dy * dy
        if k == 0:
            first = place
        # Find the place of this index: the indices are sorted by their distance along the outline
        # from the first corner.
        place = (place - first) % total
        n = count
        while n > 0 and breaks[n - 1] > place:
            n -= 1
        if n > 0 and breaks[n - 1] == place:
            continue
        for i in range(count, n, -1):
            breaks[i] = breaks[i - 1]
        breaks[n] = place
        count += 1
    for n in range(count):
        breaks[n] = (breaks[n] + first) % total
    return count


@jit("f8[:,::1], i8, i8, f8[::1]", allocates=False)
def _fit_line(points, first, last, line):
    """Fit a line to the points of an outline from index `first` to index `last`.

    The result is written to `line` (7,), whose elements `propagate_line_errors` lists.
    """
    total = len(points)
    count = (last - first) % total
    count = total if count == 0 else count
    # The grey levels near a corner depend on both sides that meet there. Therefore, at each end of
    # a side, three points are omitted, or a third of its points if it has fewer than nine.
    cut = min(3, count // 3)
    size = count - 2 * cut + 1
    x = y = 0.0
    for n in range(size):
        k = (first + cut + n) % total
        x += points[k, 0]
        y += points[k, 1]
    x, y = x / size, y / size
    xx = xy = yy = 0.0
    for n in range(size):
        k = (first + cut + n) % total
        dx, dy = points[k, 0] - x, points[k, 1] - y
        xx += dx * dx
        xy += dx * dy
        yy += dy * dy
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    along_x, along_y = np.cos(angle), np.sin(angle)
    along = across = 0.0
    for n in range(size):
        k = (first + cut + n) % total
        dx, dy = points[k, 0] - x, points[k, 1] - y
        along += (dx * along_x + dy * along_y) ** 2
        across += (dx * along_y - dy * along_x) ** 2
    line[0], line[1], line[2], line[3] = x, y, -along_y, along_x
    line[4], line[5], line[6] = size, np.sqrt(along), across


@jit("f8[:,::1], f8[:,:], i8, f8[:,::1], f8[:,::1]")
def fit_sides(points, rough, repeats, corners, lines):
    """Fit lines to the sides of an outline by total least squares, and intersect them.

    Args:
        points: (m, 2) points of the closed outline.
        rough: (k, 2) rough corners, which separate the sides of the first fit.
        repeats: number of fits; each fit separates the sides at the corners of the previous fit.
        corners: (MAX_CORNERS, 2) array to which the n corners are written.
        lines: (MAX_CORNERS, 7) array to which the n lines are written, as in
            `propagate_line_errors`. Line k leads from corner k to the next corner.

    Returns:
        The number n of corners; if it is below 3 or above MAX_CORNERS, the arrays are not valid.
    """
    breaks = np.empty(max(len(rough), MAX_CORNERS), np.int64)
    count = 0
    for repeat in range(repeats):
        count = _find_breaks(points, rough if repeat == 0 else corners[:count], breaks)
        if count < 3 or count > MAX_CORNERS:
            return count
        for n in range(count):
            _fit_line(points, breaks[n], breaks[n + 1 if n + 1 < count else 0], lines[n])
        for n in range(count):
            before = n - 1 if n > 0 else count - 1
            ax, ay, bx, by = lines[before, 2], lines[before, 3], lines[n, 2], lines[n, 3]
            da = ax * lines[before, 0] + ay * lines[before, 1]
            db = bx * lines[n, 0] + by * lines[n, 1]
            cross = ax * by - ay * bx
            if abs(cross) < PARALLEL:  # parallel lines have no intersection
                corners[n, 0], corners[n, 1] = points[breaks[n], 0], points[breaks[n], 1]
            else:
                corners[n, 0] = (da * by - db * ay) / cross
                corners[n, 1] = (ax * db - bx * da) / cross
    return count
