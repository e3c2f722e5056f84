"""Accuracy of the intersections of lines that are fitted to edge points.

Let a line n . p = d be fitted to m edge points p whose distances from the line have the standard
deviation sigma. The offset of the line at the middle of the points then has the standard deviation
sigma / sqrt(m). The angle of the line has the standard deviation sigma / sqrt(sum of r^2), where r
is the distance of a point from the middle. Both errors are independent. A corner is the
intersection of two lines, and neighbouring corners share a line, so their errors are correlated.
Acute corners and corners of short sides have the largest errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .polygons import Array

# The variance assumed for a line's points is a weighted mean of two values: the variance of these
# points (weight: its number of degrees of freedom) and the average variance over all lines (weight:
# SHARED_ERROR). The first value alone is too small if there are few points, or if the line is
# parallel to the rows or columns, because all its points then have nearly the same error.
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

    @property
    def direction(self) -> Array:
        """Unit vector (2,) along the line."""
        return np.array([self.normal[1], -self.normal[0]])

    @property
    def degrees_of_freedom(self) -> float:
        """Degrees of freedom of the points' variance: `count` - 2, but at least 0.5."""
        return max(self.count - 2.0, 0.5)


def compute_crossing_spread(lines: Sequence[FittedLine]) -> Array:
    """Compute the uncertainty of the points at which each of n lines meets the line before it.

    Each line has two independent errors, the error of its offset and the error of its angle.

    Returns:
        (2n, 2n) array S. Column k is the change of the points' coordinates (x_0, y_0, x_1, ...) if
        the error k has the size of its standard deviation. Their covariance is S S^T.
    """
    count = len(lines)
    average_variance = sum(line.squares for line in lines) / sum(
        line.degrees_of_freedom for line in lines
    )
    spread = np.zeros((2 * count, 2 * count))
    for corner in range(count):
        pair = (corner - 1) % count, corner
        normals = np.array([lines[i].normal for i in pair])
        inverse = np.linalg.pinv(normals, PARALLEL)
        point = inverse @ [n @ lines[i].middle for n, i in zip(normals, pair, strict=True)]
        for column, i in zip(inverse.T, pair, strict=True):
            line = lines[i]
            variance = (line.squares + SHARED_ERROR * average_variance) / (
                line.degrees_of_freedom + SHARED_ERROR
            )
            along = (point - line.middle) @ line.direction
            rows = slice(2 * corner, 2 * corner + 2)
            spread[rows, 2 * i] += column * np.sqrt(variance / line.count)
            spread[rows, 2 * i + 1] += column * np.sqrt(variance) * along / line.length
    return spread


def compute_rms_deviation(spread: Array) -> float:
    """Return the rms of the standard deviations of n points' coordinates.

    spread: (2n, m) uncertainty of the points, such as the result of `compute_crossing_spread`.
    """
    return float(np.sqrt((spread**2).sum() / len(spread)))
