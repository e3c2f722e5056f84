"""Accuracy of the intersections of lines that are fitted to edge points.

Let a line n . p = d be fitted to m edge points p whose distances from the line have the standard
deviation sigma. The offset of the line at the middle of the points then has the standard deviation
sigma / sqrt(m). The angle of the line has the standard deviation sigma / sqrt(sum of r^2), where r
is the distance, along the line, of a point from the middle of the points. Both errors are
independent. A corner is the intersection of two lines, and neighbouring corners share a line, so
their errors are correlated. Acute corners and corners of short sides have the largest errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import NamedTuple

import numpy as np

from aras_visual_servo_base.compiled import jit

from .polygons import Array

# The variance of a line's points is estimated as a weighted mean: the average variance over all
# lines has this weight, the variance of the line's own points has the weight of their degrees of
# freedom. The latter alone is too small if the points are few, or if the line is parallel to the
# image rows or columns, where all points have nearly the same error.
SHARED_ERROR = 6.0
PARALLEL = 0.05  # two lines are parallel if the sine of their angle is below this value


class FittedLine(NamedTuple):
    """A line and the statistics of the points to which it was fitted.

    Attributes:
        middle: (2,) mean of the points.
        normal: (2,) unit normal of the line.
        count: number of points with independent errors.
        length: square root of the sum of r^2, where r is the distance, along the line, of a point
            from the middle.
        squares: sum of the squared distances of the points from the line.
    """

    middle: Array
    normal: Array
    count: float
    length: float
    squares: float

    @classmethod
    def fit(cls, points: Array, normal: Array, count: float) -> FittedLine:
        """Return the line with a given normal through the mean of points (m, 2).

        The errors of neighbouring points are correlated. `count` is the number of points with
        independent errors that would determine the line as accurately as the m points.
        """
        middle = points.mean(axis=0)
        across = (points - middle) @ normal
        along = (points - middle) @ [normal[1], -normal[0]]
        length = float(np.sqrt(count * np.mean(along**2)))
        return cls(middle, normal, count, length, float(count * np.mean(across**2)))


def compute_crossing_spread(lines: Sequence[FittedLine]) -> Array:
    """Compute the uncertainty of the intersections of n lines, each with the line before it.

    Returns:
        (2n, 2n) array S, where S S^T is the covariance of the intersections' coordinates (x_0, y_0,
        x_1, ...).
    """
    rows = np.array([(*line.middle, *line.normal, *line[2:]) for line in lines])
    spread = np.empty((2 * len(rows), 2 * len(rows)))
    propagate_line_errors(rows, spread)
    return spread


@jit("f8[:,:], f8[:,::1]", allocates=False)
def propagate_line_errors(lines, spread):
    """Compute the uncertainty of the intersections of n lines, each with the line before it.

    Each line has two independent errors, the error of its offset and the error of its angle.

    Args:
        lines: (n, 7) middle x and y, normal x and y, count, length and squares of each line, as in
            FittedLine.
        spread: (2n, 2n) array S to which the result is written. Column k is the change of the
            intersections' coordinates (x_0, y_0, x_1, ...) if the k-th error has the size of its
            standard deviation. The covariance of the coordinates is S S^T.
    """
    count = len(lines)
    for i in range(2 * count):
        for j in range(2 * count):
            spread[i, j] = 0.0
    squares = freedom = 0.0
    for i in range(count):
        squares += lines[i, 6]
        freedom += max(lines[i, 4] - 2.0, 0.5)
    average_variance = squares / freedom
    for corner in range(count):
        i = corner - 1 if corner > 0 else count - 1
        ax, ay, bx, by = lines[i, 2], lines[i, 3], lines[corner, 2], lines[corner, 3]
        # The columns (pa, qa) and (pb, qb) are the pseudo-inverse of the matrix with the rows
        # (ax, ay) and (bx, by). Its singular values are sqrt(1 + |cosine|) and sqrt(1 - |cosine|).
        cosine = ax * bx + ay * by
        if 1.0 - abs(cosine) > PARALLEL * PARALLEL * (1.0 + abs(cosine)):
            determinant = ax * by - ay * bx
            pa, qa = by / determinant, -bx / determinant
            pb, qb = -ay / determinant, ax / determinant
        else:  # for parallel lines, ignore the smaller singular value, which is nearly zero
            sign = 1.0 if cosine >= 0.0 else -1.0
            scale = 0.5 / (1.0 + abs(cosine))
            pa, qa = scale * (ax + sign * bx), scale * (ay + sign * by)
            pb, qb = sign * pa, sign * qa
        along_a = ax * lines[i, 0] + ay * lines[i, 1]
        along_b = bx * lines[corner, 0] + by * lines[corner, 1]
        x, y = pa * along_a + pb * along_b, qa * along_a + qb * along_b
        for k in range(2):
            n = i if k == 0 else corner
            p, q = (pa, qa) if k == 0 else (pb, qb)
            variance = (lines[n, 6] + SHARED_ERROR * average_variance) / (
                max(lines[n, 4] - 2.0, 0.5) + SHARED_ERROR
            )
            along = (x - lines[n, 0]) * lines[n, 3] - (y - lines[n, 1]) * lines[n, 2]
            offset, angle = np.sqrt(variance / lines[n, 4]), np.sqrt(variance) * along / lines[n, 5]
            spread[2 * corner, 2 * n] += p * offset
            spread[2 * corner + 1, 2 * n] += q * offset
            spread[2 * corner, 2 * n + 1] += p * angle
            spread[2 * corner + 1, 2 * n + 1] += q * angle


def compute_rms_deviation(spread: Array) -> float:
    """Return the rms of the standard deviations of n points' coordinates.

    spread: (2n, m) array S, where S S^T is the covariance of the coordinates.
    """
    return sqrt(np.add.reduce(spread**2, axis=None) / len(spread))
