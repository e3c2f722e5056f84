"""Functions of closed polygons.

A polygon is an array (n, 2) of vertices in order. The last vertex is connected to the first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def cross(a: Array, b: Array) -> Array:
    """Compute the cross product a x b of vectors (..., 2); the result has the shape (...)."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def next_vertices(vertices: Array) -> Array:
    """Return for each vertex (n, ...) of a closed polygon the next vertex.

    The result is that of np.roll(vertices, -1, axis=0), but takes a fifth of the time.
    """
    return np.concatenate((vertices[1:], vertices[:1]))


def signed_area(polygon: Array) -> float:
    """Compute the signed area of a closed polygon (n, 2) by the shoelace formula.

    The area is positive if the vertices are in the direction from the x axis to the y axis. The
    edges must not cross.
    """
    x, y = polygon.T
    return 0.5 * float(np.dot(x, next_vertices(y)) - np.dot(y, next_vertices(x)))


def find_crossing(vertices: Array) -> tuple[int, int] | None:
    """Return the indices of the first two edges of a closed polygon (n, 2) that cross.

    Return None if no edges cross. Edges that only touch at an end do not cross.
    """
    p = np.asarray(vertices, dtype=float)
    q = next_vertices(p)
    edge = q - p
    # The signs of start[k, l] and end[k, l] are the sides of edge k on which edge l starts and
    # ends.
    start = cross(edge[:, None, :], p[None, :, :] - p[:, None, :])
    end = cross(edge[:, None, :], q[None, :, :] - p[:, None, :])
    separated = start * end < 0.0
    both = separated & separated.T
    if not both.any():
        return None
    crossing = np.argwhere(np.triu(both, 2))
    return None if len(crossing) == 0 else (int(crossing[0, 0]), int(crossing[0, 1]))
