"""Closed polygons with ordered vertices (n, 2); the last vertex is joined to the first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def cross(a: Array, b: Array) -> Array:
    """Compute the cross products (...) of vectors (..., 2)."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def next_vertices(vertices: Array) -> Array:
    """Return the successor of each vertex (n, ...) of a closed polygon.

    It is np.roll by -1 in a fifth of the time.
    """
    return np.concatenate((vertices[1:], vertices[:1]))


def signed_area(polygon: Array) -> float:
    """Compute the area of a closed polygon (n, 2) without crossing edges by the shoelace formula.

    It is positive for an orientation from x to y.
    """
    x, y = polygon.T
    return 0.5 * float(np.dot(x, next_vertices(y)) - np.dot(y, next_vertices(x)))


def find_crossing(vertices: Array) -> tuple[int, int] | None:
    """Find the first two edges of a closed polygon (n, 2) that cross in their interiors, or None.
    """
    p = np.asarray(vertices, dtype=float)
    q = next_vertices(p)
    edge = q - p
    # start[k, l], end[k, l]: the side of edge k on which the start and the end of edge l lie
    start = cross(edge[:, None, :], p[None, :, :] - p[:, None, :])
    end = cross(edge[:, None, :], q[None, :, :] - p[:, None, :])
    separated = start * end < 0.0
    both = separated & separated.T
    if not both.any():
        return None
    crossing = np.argwhere(np.triu(both, 2))
    return None if len(crossing) == 0 else (int(crossing[0, 0]), int(crossing[0, 1]))
