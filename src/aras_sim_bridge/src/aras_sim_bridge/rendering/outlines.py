"""Which triangles lie in which rectangles, as seen from the eye: for drawing tiles again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .compiled import compiled


@dataclass(frozen=True)
class Outlines:
    """Triangles on planes x / z, y / z before the eye.

    corners: (N, 3, 3), in a frame for each whose z is the depth, m.
    bounds: (N, 4) low x, low y, high x, high y, of the part beyond the near distance.
    """

    corners: np.ndarray
    bounds: np.ndarray

    @classmethod
    def of(cls, corners: np.ndarray, near: float) -> Outlines:
        return cls(corners, _bounds(corners, near))

    def within(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """(M,) those whose bounds touch the rectangle with corners (2,)."""
        return _within(self.bounds, low, high)

    def of_some(self, some: np.ndarray) -> Outlines:
        """Those of a list."""
        return Outlines(self.corners[some], self.bounds[some])

    def overlapping(self, low: np.ndarray, high: np.ndarray, on: np.ndarray | None = None,
                    plane: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Pairs (rectangle, triangle), rectangle by rectangle, that may overlap.

        low, high: (R, 2) corners. on (R,), plane (N,): numbers of the planes that the rectangles
            and the triangles are on; None where there is only one.
        """
        if on is None or plane is None:
            on, plane = np.zeros(len(low), int), np.zeros(len(self.bounds), int)
        return _overlapping(self.corners, self.bounds, low, high, on, plane)


@compiled("f8[:,:,::1], f8")
def _bounds(p, near):
    """(N, 4) bounds in x / z, y / z of triangles (N, 3, 3), cut off at z = near."""
    out = np.empty((len(p), 4))
    for i in range(len(p)):
        low_x = low_y = np.inf
        high_x = high_y = -np.inf
        for k in range(3):
            x, y, z = p[i, k]
            if z > near:
                low_x, high_x = min(low_x, x / z), max(high_x, x / z)
                low_y, high_y = min(low_y, y / z), max(high_y, y / z)
            u, v, w = p[i, (k + 1) % 3]
            if (z > near) != (w > near):
                s = (near - z) / (w - z)
                x, y = (x + s * (u - x)) / near, (y + s * (v - y)) / near
                low_x, high_x = min(low_x, x), max(high_x, x)
                low_y, high_y = min(low_y, y), max(high_y, y)
        out[i] = low_x, low_y, high_x, high_y
    return out


@compiled("f8[:,::1], f8[::1], f8[::1]")
def _within(bounds, low, high):
    """See Outlines.within."""
    out = np.empty(len(bounds), np.int64)
    found = 0
    for n in range(len(bounds)):
        low_x, low_y, high_x, high_y = bounds[n]
        if low_x < high[0] and low_y < high[1] and high_x > low[0] and high_y > low[1]:
            out[found] = n
            found += 1
    return out[:found]


@compiled("f8[:,:,::1]")
def _sides(corners):
    """(N, 3, 3) inward normals of the planes through the eye and the sides of triangles."""
    out = np.empty_like(corners)
    for i in range(len(corners)):
        for k in range(3):
            a, b = corners[i, k], corners[i, (k + 1) % 3]
            out[i, k, 0] = a[1] * b[2] - a[2] * b[1]
            out[i, k, 1] = a[2] * b[0] - a[0] * b[2]
            out[i, k, 2] = a[0] * b[1] - a[1] * b[0]
        c = corners[i, 2]
        if out[i, 0, 0] * c[0] + out[i, 0, 1] * c[1] + out[i, 0, 2] * c[2] < 0.0:
            out[i] = -out[i]
    return out


@compiled("f8[:,:,::1], f8[:,::1], f8[:,::1], f8[:,::1], i8[::1], i8[::1]")
def _overlapping(corners, bounds, low, high, on, plane):
    """See Outlines.overlapping."""
    sides = _sides(corners)
    rectangle = np.empty(len(low) * len(corners), np.int64)
    triangle = np.empty_like(rectangle)
    found = 0
    for r in range(len(low)):
        low_x, low_y = low[r]
        high_x, high_y = high[r]
        for t in range(len(corners)):
            if (plane[t] != on[r] or bounds[t, 0] >= high_x or bounds[t, 1] >= high_y
                    or bounds[t, 2] <= low_x or bounds[t, 3] <= low_y):
                continue
            # A side has the whole rectangle outside if even the innermost corner is.
            for k in range(3):
                x, y, z = sides[t, k]
                if max(x * low_x, x * high_x) + max(y * low_y, y * high_y) + z < 0.0:
                    break
            else:
                rectangle[found], triangle[found] = r, t
                found += 1
    return rectangle[:found], triangle[:found]
