"""Which triangles lie in which rectangles, as seen from the eye: for drawing tiles again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Outlines:
    """Triangles on planes x / z, y / z before the eye.

    corners: (N, 3, 3), in a frame for each whose z is the depth, m.
    bounds: (4, N) low x, low y, high x, high y, of the part beyond the near distance.
    """

    corners: np.ndarray
    bounds: np.ndarray

    @classmethod
    def of(cls, corners: np.ndarray, near: float) -> Outlines:
        return cls(corners, _projected_bounds(corners, near))

    def within(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """(N,) bool, whose bounds touch the rectangle with corners (2,)."""
        low_x, low_y, high_x, high_y = self.bounds
        return (low_x < high[0]) & (low_y < high[1]) & (high_x > low[0]) & (high_y > low[1])

    def of_some(self, some: np.ndarray) -> Outlines:
        """Those of a mask or list."""
        return Outlines(self.corners[some], self.bounds[:, some])

    def overlapping(self, low: np.ndarray, high: np.ndarray, possible: np.ndarray | None = None
                    ) -> tuple[np.ndarray, np.ndarray]:
        """Pairs (rectangle, triangle), rectangle by rectangle, that may overlap.

        low, high: (R, 2) corners. possible: (R, N) bool, pairs on the same plane; None for all.
        """
        low_x, low_y, high_x, high_y = self.bounds
        overlap = (high_x > low[:, :1]) & (low_x < high[:, :1])
        overlap &= (high_y > low[:, 1:]) & (low_y < high[:, 1:])
        if possible is not None:
            overlap &= possible
        rectangle, triangle = np.nonzero(overlap)
        # A side has the whole rectangle outside if even the innermost corner is.
        edge = _sides(self.corners[triangle])
        a, b = low[rectangle, None], high[rectangle, None]
        inner = np.maximum(edge[..., :2] * a, edge[..., :2] * b).sum(axis=2) + edge[..., 2]
        inside = (inner >= 0.0).all(axis=1)
        return rectangle[inside], triangle[inside]


def _sides(corners: np.ndarray) -> np.ndarray:
    """(N, 3, 3) inward normals of the planes through the eye and the sides of triangles."""
    ax, ay, az = corners.transpose(2, 0, 1)
    bx, by, bz = corners[:, [1, 2, 0]].transpose(2, 0, 1)
    normal = np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=2)
    turn = (normal[:, 0] * corners[:, 2]).sum(axis=1)
    return normal * np.sign(turn)[:, None, None]


def _projected_bounds(p: np.ndarray, near: float) -> np.ndarray:
    """(4, N) bounds in x / z, y / z of triangles (N, 3, 3); of the part beyond near."""
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    front = z > near
    bounds = np.empty((4, len(p)))
    cut = np.flatnonzero(~(front[:, 0] & front[:, 1] & front[:, 2]))
    safe = np.maximum(z, near)
    _extremes(x / safe, y / safe, bounds)
    if len(cut):
        bounds[:, cut] = _cut_bounds(p[cut], near)
    return bounds


def _extremes(u: np.ndarray, v: np.ndarray, out: np.ndarray) -> None:
    """Low and high of (N, 3) corner coordinates, written to (4, N)."""
    for row, (values, pick) in enumerate(((u, np.minimum), (v, np.minimum),
                                          (u, np.maximum), (v, np.maximum))):
        pick(pick(values[:, 0], values[:, 1]), values[:, 2], out=out[row])


def _cut_bounds(p: np.ndarray, near: float) -> np.ndarray:
    """(4, N) bounds in x / z, y / z of triangles (N, 3, 3), cut off at z = near."""
    q = np.roll(p, -1, axis=1)
    z, w = p[..., 2], q[..., 2]
    crosses = (z > near) != (w > near)
    s = np.where(crosses, (near - z) / np.where(crosses, w - z, 1.0), 0.0)
    on_plane = (p + s[..., None] * (q - p))[..., :2] / near
    inner = p[..., :2] / np.maximum(z, near)[..., None]
    points = np.concatenate([inner, on_plane], axis=1)
    valid = np.concatenate([z > near, crosses], axis=1)[..., None]
    low = np.where(valid, points, np.inf).min(axis=1)
    high = np.where(valid, points, -np.inf).max(axis=1)
    return np.concatenate([low, high], axis=1).T
