"""Features of a polygon's edges, from each corner to the next: lines and segments.

Reference: B. Espiau, F. Chaumette and P. Rives, A new approach to visual servoing in robotics, IEEE
Transactions on Robotics and Automation 8(3), 1992.
"""

from __future__ import annotations

import numpy as np

from aras_visual_servo_camera.interaction import point_interaction

from ..errors import MeasurementError
from .base import FEATURES
from .corners import FULL_TURN, MIN_LENGTH, CornerFeature
from .points import TOLERANCE


class EdgeFeature(CornerFeature):
    """Base class of features of a polygon's edges, from each point to the next."""

    @staticmethod
    def edges(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the first ends, last ends, lengths and directions of the edges.

        Their shapes are (n, 2), (n, 2), (n, 1) and (n, 2).

        Raises:
            MeasurementError: two neighbouring points coincide.
        """
        ends = np.roll(points, -1, axis=0)
        step = ends - points
        length = np.hypot(step[:, 0], step[:, 1])[:, None]
        if length.min() < MIN_LENGTH:
            raise MeasurementError("two neighbouring points coincide, so the edge between them is "
                                   "undefined; move the camera")
        return points, ends, length, step / length

    @staticmethod
    def edge_rates(
        points: np.ndarray, inverse_depth: np.ndarray, length: np.ndarray, direction: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """Compute the interaction matrices L (n, 6) of n edges.

        Returns:
            Six matrices: for x and y of the first end, x and y of the last end, length and angle.
        """
        L = point_interaction(points, inverse_depth)
        x, y = L[0::2], L[1::2]
        far_x, far_y = np.roll(x, -1, axis=0), np.roll(y, -1, axis=0)
        dx, dy = direction.T[:, :, None]
        longer = dx * (far_x - x) + dy * (far_y - y)
        angle = (dx * (far_y - y) - dy * (far_x - x)) / length
        return x, y, far_x, far_y, longer, angle


@FEATURES.register("lines")
class Lines(EdgeFeature):
    """s = (rho, theta) of the line of each edge, x cos(theta) + y sin(theta) = rho.

    The direction of an edge, from its first to its last end, determines the sign of its normal.
    Therefore theta covers the full turn.
    """

    component_names, periods = ("rho", "theta"), (0.0, FULL_TURN)
    component_tolerances, component_units = (TOLERANCE, 0.005), ("", "rad")

    def values(self, points: np.ndarray, inverse_depth: np.ndarray) -> np.ndarray:
        """Compute s (k,) from points (n, 2) and their inverse depths (n,)."""
        start, _, _, d = self.edges(points)
        rho = -d[:, 1] * start[:, 0] + d[:, 0] * start[:, 1]
        return np.stack([rho, np.arctan2(d[:, 0], -d[:, 1])], axis=1).ravel()

    def interaction(self, points: np.ndarray, inverse_depth: np.ndarray) -> np.ndarray:
        """Compute L (k, 6) from points (n, 2) and their inverse depths (n,)."""
        start, _, length, d = self.edges(points)
        x, y, _, _, _, angle = self.edge_rates(points, inverse_depth, length, d)
        along = (d * start).sum(axis=1)[:, None]
        rho = -d[:, 1:] * x + d[:, :1] * y - along * angle
        return np.stack([rho, angle], axis=1).reshape(-1, 6)


@FEATURES.register("segments")
class Segments(EdgeFeature):
    """s = (x_m, y_m, length, angle) of each edge, where (x_m, y_m) is its midpoint."""

    component_names, periods = ("xm", "ym", "length", "angle"), (0.0, 0.0, 0.0, FULL_TURN)
    component_tolerances = (TOLERANCE, TOLERANCE, 2.0 * TOLERANCE, 0.005)
    component_units = ("", "", "", "rad")

    def values(self, points: np.ndarray, inverse_depth: np.ndarray) -> np.ndarray:
        """Compute s (k,) from points (n, 2) and their inverse depths (n,)."""
        start, end, length, d = self.edges(points)
        middle = 0.5 * (start + end)
        return np.hstack([middle, length, np.arctan2(d[:, 1:], d[:, :1])]).ravel()

    def interaction(self, points: np.ndarray, inverse_depth: np.ndarray) -> np.ndarray:
        """Compute L (k, 6) from points (n, 2) and their inverse depths (n,)."""
        _, _, length, d = self.edges(points)
        x, y, far_x, far_y, longer, angle = self.edge_rates(points, inverse_depth, length, d)
        rows = [0.5 * (x + far_x), 0.5 * (y + far_y), longer, angle]
        return np.stack(rows, axis=1).reshape(-1, 6)


@FEATURES.register("normalised_segments")
class NormalisedSegments(EdgeFeature):
    """s = (x_m / l, y_m / l, 1 / l, angle) of each edge, with its midpoint (x_m, y_m) and length l.

    These features are nearly linear in the translation of the camera.
    """

    component_names, periods = ("xn", "yn", "inverse_length", "angle"), (0.0, 0.0, 0.0, FULL_TURN)
    component_tolerances = (0.005, 0.005, 0.01, 0.005)
    component_units = ("", "", "", "rad")

    def values(self, points: np.ndarray, inverse_depth: np.ndarray) -> np.ndarray:
        """Compute s (k,) from points (n, 2) and their inverse depths (n,)."""
        start, end, length, d = self.edges(points)
        middle = 0.5 * (start + end)
        angle = np.arctan2(d[:, 1:], d[:, :1])
        return np.hstack([middle / length, 1.0 / length, angle]).ravel()

    def interaction(self, points: np.ndarray, inverse_depth: np.ndarray) -> np.ndarray:
        """Compute L (k, 6) from points (n, 2) and their inverse depths (n,)."""
        start, end, length, d = self.edges(points)
        x, y, far_x, far_y, longer, angle = self.edge_rates(points, inverse_depth, length, d)
        xm, ym = (0.5 * (start + end)).T[:, :, None]
        shrink = longer / length**2
        rows = [
            0.5 * (x + far_x) / length - xm * shrink, 0.5 * (y + far_y) / length - ym * shrink,
            -shrink, angle,
        ]  # fmt: skip
        return np.stack(rows, axis=1).reshape(-1, 6)
