"""Draw a polygon as a grey image; the grey of a pixel follows from the area that is covered."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import jit, jit_inline


@jit_inline
def _integrate_ramp(x):
    """Return the integral of clip(t, 0, 1) over t from -inf to x."""
    within = min(max(x, 0.0), 1.0)
    return 0.5 * within * within + max(x - 1.0, 0.0)


@jit("f8[:,:], f8, f8, u1[:,::1]")
def draw_polygon(polygon, outside, inside, image):
    """Draw a polygon.

    The grey level of a pixel changes from `outside` to `inside` with the fraction of its area that
    the polygon covers. The covered area is a sum over the edges: each edge adds the part of the
    pixel's area that is on the left of the edge, with a sign that depends on whether the edge goes
    up or down.

    Args:
        polygon: corners (n, 2), px; pixel centres have integer coordinates.
        outside, inside: grey levels.
        image: (rows, columns); only pixels in the bounding box of the polygon are written.
    """
    rows, columns = image.shape
    count = len(polygon)
    left, right, top, bottom = np.inf, -np.inf, np.inf, -np.inf
    for n in range(count):
        left, right = min(left, polygon[n, 0]), max(right, polygon[n, 0])
        top, bottom = min(top, polygon[n, 1]), max(bottom, polygon[n, 1])
    # The bounds of the polygon are compared before they are converted to integers, which cannot
    # represent large numbers.
    if not (right >= -0.5 and left <= columns - 0.5 and bottom >= -0.5 and top <= rows - 0.5):
        return
    first_column = int(np.floor(max(left, 0.0) + 0.5))
    first_row = int(np.floor(max(top, 0.0) + 0.5))
    end_column = min(int(np.floor(min(right, float(columns)) + 0.5)) + 1, columns)
    end_row = min(int(np.floor(min(bottom, float(rows)) + 0.5)) + 1, rows)
    # Contributions of the edges to the covered areas of the pixels in a row. `crossed[j]`: from
    # edges that cross pixel j. `beyond[j]`: from edges on the right of pixel j, for pixel j and all
    # pixels on its left.
    crossed, beyond = np.zeros(columns + 1), np.zeros(columns + 1)
    for row in range(first_row, end_row):
        for n in range(count):
            following = n + 1 if n + 1 < count else 0
            x0, y0 = polygon[n, 0], polygon[n, 1]
            x1, y1 = polygon[following, 0], polygon[following, 1]
            low = min(max(min(y0, y1), row - 0.5), row + 0.5)
            high = min(max(max(y0, y1), row - 0.5), row + 0.5)
            if not high > low:
                continue
            height = high - low if y1 > y0 else low - high
            slope = (x1 - x0) / (y1 - y0)
            start, end = x0 + slope * (low - y0), x0 + slope * (high - y0)
            near, far = min(start, end) + 0.5, max(start, end) + 0.5
            if far <= first_column:
                continue
            near_column = first_column
            if near > first_column:
                near_column = end_column if near >= end_column else int(near)
            if near_column > first_column:
                beyond[near_column - 1] += height
            far_column = end_column if far >= end_column else int(far) + 1
            across = end - start
            for column in range(near_column, far_column):
                first, last = start - (column - 0.5), end - (column - 0.5)
                if abs(across) < 1e-6:
                    width = min(max(0.5 * (first + last), 0.0), 1.0)
                else:
                    width = (_integrate_ramp(last) - _integrate_ramp(first)) / across
                crossed[column] += height * width
        area, level = 0.0, np.uint8(outside)
        for column in range(end_column - 1, first_column - 1, -1):
            if beyond[column] != 0.0 or crossed[column] != 0.0:
                area += beyond[column]
                covered = min(abs(area + crossed[column]), 1.0)
                image[row, column] = np.uint8(np.rint(outside + (inside - outside) * covered))
                level = np.uint8(np.rint(outside + (inside - outside) * min(abs(area), 1.0)))
                beyond[column] = crossed[column] = 0.0
            else:
                image[row, column] = level
