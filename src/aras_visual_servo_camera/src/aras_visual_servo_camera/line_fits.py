"""How exactly lines fitted to edge points tell where they meet.

A line n . p = d through m edge points that scatter by sigma about it errs by sigma / sqrt(m) in its
offset at their middle, and by sigma over the root of the sum of the squared ways from there in its
angle; both are independent. A corner is where two lines meet, and neighbours share a line: their
errors are correlated, and an acute corner, or one at the end of a short side, errs most.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .polygons import Array

# Points of the average line that count beside a line's own where it is asked how they scatter: of a
# few points, or of an edge along a row of pixels, all err alike and scatter little.
SHARED_ERROR = 6.0
PARALLEL = 0.05  # sine of the angle between lines that do not meet


class FittedLine(NamedTuple):
    """A line and the points that it was fitted to.

    middle, normal: (2,) of the points, and across the line. count: of independent points.
    length: root of the sum of their squared ways from the middle. squares: sum of the squares by
    which they are off the line.
    """

    middle: Array
    normal: Array
    count: float
    length: float
    squares: float

    @classmethod
    def fit(cls, points: Array, normal: Array, count: float) -> FittedLine:
        """The line through points (m, 2) that tell as much as `count` independent ones."""
        middle = points.mean(axis=0)
        across = (points - middle) @ normal
        along = (points - middle) @ [normal[1], -normal[0]]
        length = float(np.sqrt(count * np.mean(along**2)))
        return cls(middle, normal, count, length, float(count * np.mean(across**2)))

    @property
    def direction(self) -> Array:
        """(2,) along the line."""
        return np.array([self.normal[1], -self.normal[0]])

    @property
    def degrees_of_freedom(self) -> float:
        """How many of its points tell how they scatter."""
        return max(self.count - 2.0, 0.5)


def compute_crossing_spread(lines: Sequence[FittedLine]) -> Array:
    """Effects (2n, 2n) of independent errors, one standard deviation each, on the places (x_0, y_0,
    x_1, ...) at which each of n lines meets the one before it."""
    count = len(lines)
    shared = sum(line.squares for line in lines) / sum(line.degrees_of_freedom for line in lines)
    spread = np.zeros((2 * count, 2 * count))
    for corner in range(count):
        pair = (corner - 1) % count, corner
        normals = np.array([lines[i].normal for i in pair])
        meeting = np.linalg.pinv(normals, PARALLEL)
        place = meeting @ [n @ lines[i].middle for n, i in zip(normals, pair, strict=True)]
        for column, i in zip(meeting.T, pair, strict=True):
            line = lines[i]
            variance = (line.squares + SHARED_ERROR * shared) / (
                line.degrees_of_freedom + SHARED_ERROR
            )
            along = (place - line.middle) @ line.direction
            rows = slice(2 * corner, 2 * corner + 2)
            spread[rows, 2 * i] += column * np.sqrt(variance / line.count)
            spread[rows, 2 * i + 1] += column * np.sqrt(variance) * along / line.length
    return spread


def compute_rms_deviation(spread: Array) -> float:
    """Standard deviation of coordinates, rms, of a spread (2n, m)."""
    return float(np.sqrt((spread**2).sum() / len(spread)))
