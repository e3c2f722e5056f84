"""Accuracy of the intersections of lines that are fitted to edge points.

Let a line n . p = d be fitted to m edge points with a standard deviation sigma across the line. Its
offset at the middle of the points then has the error sigma / sqrt(m). Its angle has the error
sigma over the root of the sum of the squared distances from the middle. Both errors are
independent. A corner is the intersection of two lines, and neighbouring corners share a line, so
their errors are correlated. Acute corners and corners of short sides have the largest errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .polygons import Array

# Weight, in points, of the average variance of all lines in the variance of one line. The scatter
# of a few points, or of an edge along a row of pixels, underestimates the error, because all of the
# points have nearly the same error.
SHARED_ERROR = 6.0
PARALLEL = 0.05  # sine of the angle below which two lines count as parallel


class FittedLine(NamedTuple):
    """A line and the statistics of the points to which it was fitted.

    middle: (2,) mean of the points.
    normal: (2,) unit normal of the line.
    count: number of independent points.
    length: root of the sum of the squared distances of the points from the middle, along the line.
    squares: sum of the squared distances of the points from the line.
    """

    middle: Array
    normal: Array
    count: float
    length: float
    squares: float

    @classmethod
    def fit(cls, points: Array, normal: Array, count: float) -> FittedLine:
        """Return the line through points (m, 2) with a given normal.

        The points carry as much information as `count` independent ones.
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
        """Number of points that determine the scatter, i.e. two less than their count."""
        return max(self.count - 2.0, 0.5)


def compute_crossing_spread(lines: Sequence[FittedLine]) -> Array:
    """Compute the uncertainty of the points at which each of n lines meets the line before it.

    Returns:
        (2n, 2n). Column k is the effect of one independent error, with one standard deviation, on
        the coordinates (x_0, y_0, x_1, ...) of the points.
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
    """Compute the rms standard deviation of the coordinates of a spread (2n, m)."""
    return float(np.sqrt((spread**2).sum() / len(spread)))
