"""Features of numbered points: corners of a polygon, dots, keypoints of a texture.

Each feature is a function of image points p_i = (x_i, y_i) of a plane. Its interaction matrix
follows from that of the points by the chain rule. Vanishing points are an exception: they depend on
rotations only and have their own interaction matrix.

References: F. Chaumette and S. Hutchinson, Visual servo control, parts I and II, IEEE Robotics and
Automation Magazine 13(4), 2006 and 14(1), 2007; B. Espiau, F. Chaumette and P. Rives, A new
approach to visual servoing in robotics, IEEE Transactions on Robotics and Automation 8(3), 1992
(vanishing points).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import ClassVar

import numpy as np

from aras_visual_servo_base.poses import skew
from aras_visual_servo_camera.interaction import point_interaction

from ..errors import ConfigurationError, MeasurementError
from ..goals.goal import Goal
from ..observation.observation import Need, Observation
from .base import (
    FEATURES,
    DepthRelativeTolerance,
    FeatureMeasurement,
    get_plane,
    wrap,
    wrap_together,
)
from .points import TOLERANCE, PointFeature, backproject, compute_inverse_depth

FULL_TURN = 2.0 * np.pi
# Tolerances of the coordinates X, Y and Z of a point, where Z is along the optical axis.
POINT_TOLERANCES = (
    DepthRelativeTolerance(TOLERANCE),
    DepthRelativeTolerance(TOLERANCE),
    DepthRelativeTolerance(2.0 * TOLERANCE),
)
MIN_LENGTH = 1e-9  # normalised length; the direction of a shorter side is undefined


@FEATURES.register("numbered_points")
class NumberedPoints(PointFeature):
    """s = (x_0, y_0, x_1, y_1, ...) of numbered points, in normalised coordinates.

    Dots, markers and the points of an exact camera have numbers. The corners of a segmented outline
    have no numbers; they are matched to the goal's corners.
    """

    needs = frozenset((Need.CORNERS,))

    def points(self, observation: Observation) -> np.ndarray:
        """Return the points (n, 2) in this image, in normalised coordinates."""
        if observation.corners is None:
            raise MeasurementError(
                f"{self.name} needs corners, which this observation does not have: use a polygon "
                "as the target, or a feature without corners, such as area"
            )
        return observation.corners

    def _match_to_goal(
        self, observation: Observation, desired: np.ndarray
    ) -> tuple[np.ndarray, str]:
        """Return the points (n, 2) in the goal's order, and the angle by which it is ambiguous.

        Raises:
            MeasurementError: the number of points differs from the goal's, or a coordinate is not
                finite.
        """
        points = self._check_count(observation, desired)
        if observation.is_numbered is False and Need.CORNERS in self.needs:
            return self._match_outline(points, desired)
        return points, ""


class CornerFeature(NumberedPoints):
    """Base class of features that are computed from numbered points.

    Attributes:
        component_names: names of the components of one element, such as a point or an edge.
        periods: period of each component, rad; 0 if the component is not an angle.
        component_tolerances: tolerance of each component.
        component_units: unit of each component.
    """

    component_names: ClassVar[tuple[str, ...]]
    periods: ClassVar[tuple[float, ...]]
    component_tolerances: ClassVar[tuple[float, ...]]
    component_units: ClassVar[tuple[str, ...]]

    @abstractmethod
    def values(self, points: np.ndarray, inverse_depth: np.ndarray) -> np.ndarray:
        """Compute s (k,) from points (n, 2) and their inverse depths 1/Z (n,), 1/m.

        Raises:
            MeasurementError: s is undefined for these points.
        """

    @abstractmethod
    def interaction(self, points: np.ndarray, inverse_depth: np.ndarray) -> np.ndarray:
        """Compute L (k, 6) from points (n, 2) and their inverse depths 1/Z (n,), 1/m."""

    def count_elements(self, count: int) -> int:
        """Return the number of elements, such as points or edges, for `count` points."""
        return count

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """Measure s, s*, the error and L in one image."""
        desired = self.read_desired_points(goal)
        points, ambiguity = self._match(observation, desired)
        w = compute_inverse_depth(get_plane(observation), points)
        s = self.values(points, w)
        goal_s = self.values(desired, self._compute_goal_inverse_depth(goal, desired))
        error = self._wrap_change(s - goal_s, wrap_together)
        L = self.interaction(points, w)
        return FeatureMeasurement(s, goal_s, error, L, ambiguity=ambiguity)

    def accuracy(self, observation: Observation, goal: Goal) -> np.ndarray | None:
        """Return the accuracy of s, propagated from that of the points by finite differences."""
        points = super().accuracy(observation, goal)
        if points is None:
            return None
        desired = self.read_desired_points(goal)
        w = self._compute_goal_inverse_depth(goal, desired)
        s = self.values(desired, w)
        moved = np.transpose([self.values(desired + d.reshape(-1, 2), w) - s for d in points.T])
        return self._wrap_change(moved)

    def _wrap_change(
        self, change: np.ndarray, modulo: Callable[[np.ndarray, float], np.ndarray] = wrap
    ) -> np.ndarray:
        """Wrap those components of a change of s that are angles, modulo their periods.

        Args:
            change: (k,) or (k, m) change of s, or m changes.
            modulo: function that wraps angles, such as `wrap`.
        """
        for i, period in enumerate(self.periods):
            if period:
                every = slice(i, None, len(self.component_names))
                change[every] = modulo(change[every], period)
        return change

    def desired_interaction(self, goal: Goal) -> np.ndarray:
        """Return the interaction matrix L (k, 6) at the goal."""
        desired = self.read_desired_points(goal)
        return self.interaction(desired, self._compute_goal_inverse_depth(goal, desired))

    def check(self, goal: Goal) -> None:
        """Refuse a goal that this feature cannot servo to."""
        super().check(goal)
        try:
            desired = self.read_desired_points(goal)
            self.values(desired, self._compute_goal_inverse_depth(goal, desired))
        except MeasurementError as error:
            raise ConfigurationError(f"{goal.name}: {error}") from error

    def _set_count(self, count: int) -> None:
        self.count = count
        k = self.count_elements(count)
        self.names = tuple(f"{part}{i}" for i in range(k) for part in self.component_names)
        self.tolerances, self.units = self.component_tolerances * k, self.component_units * k


@FEATURES.register("polar_points")
class PolarPoints(CornerFeature):
    """s = (rho, theta) of each point, in polar coordinates about the principal point.

    A rotation of the camera about its optical axis is a straight path in these coordinates.

    Reference: M. Iwatsuki and N. Okiyama, A new formulation of visual servoing based on
    cylindrical coordinate system, IEEE Transactions on Robotics 21(2), 2005.
    """

    component_names, periods = ("rho", "theta"), (0.0, FULL_TURN)
    component_tolerances, component_units = (TOLERANCE, 0.005), ("", "rad")

    def values(self, points: np.ndarray, inverse_depth: np.ndarray) -> np.ndarray:
        """Compute s (k,) from points (n, 2) and their inverse depths (n,)."""
        rho = np.hypot(points[:, 0], points[:, 1])
        if rho.min() < MIN_LENGTH:
            raise MeasurementError(
                "a point on the optical axis has no polar angle; use the feature points"
            )
        return np.stack([rho, np.arctan2(points[:, 1], points[:, 0])], axis=1).ravel()

    def interaction(self, points: np.ndarray, inverse_depth: np.ndarray) -> np.ndarray:
        """Compute L (k, 6) from points (n, 2) and their inverse depths (n,)."""
        rho = np.hypot(points[:, 0], points[:, 1])[:, None]
        c, s = (points / rho).T[:, :, None]
        L = point_interaction(points, inverse_depth)
        x, y = L[0::2], L[1::2]
        return np.stack([c * x + s * y, (c * y - s * x) / rho], axis=1).reshape(-1, 6)


@FEATURES.register("points_3d")
class Points3D(CornerFeature):
    """s = (X, Y, Z) of each point in the camera frame, m; Z follows from the target's plane.

    L = [-1  [X]x]. Reference: P. Martinet and others, Vision based control law using 3D visual
    features, World Automation Congress 1996.
    """

    component_names, periods = ("X", "Y", "Z"), (0.0, 0.0, 0.0)
    component_tolerances, component_units = POINT_TOLERANCES, ("m", "m", "m")

    def values(self, points: np.ndarray, inverse_depth: np.ndarray) -> np.ndarray:
        """Compute s (k,) from points (n, 2) and their inverse depths (n,)."""
        return backproject(points, inverse_depth).ravel()

    def interaction(self, points: np.ndarray, inverse_depth: np.ndarray) -> np.ndarray:
        """Compute L (k, 6) from points (n, 2) and their inverse depths (n,)."""
        X, Y, Z = backproject(points, inverse_depth).T
        L = np.zeros((len(X), 3, 6))
        L[:, 0, 0] = L[:, 1, 1] = L[:, 2, 2] = -1.0
        L[:, 0, 4], L[:, 0, 5] = -Z, Y
        L[:, 1, 3], L[:, 1, 5] = Z, -X
        L[:, 2, 3], L[:, 2, 4] = -Y, X
        return L.reshape(-1, 6)


@FEATURES.register("depth")
class Depth(CornerFeature):
    """s = log Z of the centroid of the points, where Z is its depth; vpFeatureDepth in ViSP.

    s - s* = log(Z / Z*). L = (0, 0, -1/Z, -y, x, 0), where (x, y) is the image of the centroid.
    """

    component_names, periods = ("log_Z",), (0.0,)
    component_tolerances, component_units = (0.005,), ("",)
    directions = (False, False, True, False, False, False)

    def count_elements(self, count: int) -> int:
        """Return 1, because all points have one common depth."""
        return 1

    def values(self, points: np.ndarray, inverse_depth: np.ndarray) -> np.ndarray:
        """Compute s (k,) from points (n, 2) and their inverse depths (n,)."""
        return np.log(backproject(points, inverse_depth).mean(axis=0)[2:])

    def interaction(self, points: np.ndarray, inverse_depth: np.ndarray) -> np.ndarray:
        """Compute L (k, 6) from points (n, 2) and their inverse depths (n,)."""
        X, Y, Z = backproject(points, inverse_depth).mean(axis=0)
        return np.array([[0.0, 0.0, -1.0 / Z, -Y / Z, X / Z, 0.0]])


@FEATURES.register("vanishing_points")
class VanishingPoints(CornerFeature):
    """s = (1/rho, alpha) of the vanishing points of a quadrilateral's two pairs of sides.

    The images of two parallel sides meet in their vanishing point, whose polar coordinates are
    (rho, alpha); 1/rho is 0 if the target is parallel to the image. Vanishing points depend on
    rotations only: the direction D of the sides in the camera frame changes by
    dD/dt = D x omega.
    """

    component_names, periods = ("inverse_rho", "alpha"), (0.0, FULL_TURN)
    component_tolerances, component_units = (0.005, 0.005), ("", "rad")
    directions = (False, False, False, True, True, True)

    def count_elements(self, count: int) -> int:
        """Return 2, because four points have two pairs of sides."""
        return 2

    def values(self, points: np.ndarray, inverse_depth: np.ndarray) -> np.ndarray:
        """Compute s (k,) from points (n, 2) and their inverse depths (n,)."""
        X, Y, W = self._compute_directions(points).T
        return np.stack([W / np.hypot(X, Y), np.arctan2(Y, X)], axis=1).ravel()

    def interaction(self, points: np.ndarray, inverse_depth: np.ndarray) -> np.ndarray:
        """Compute L (k, 6) from points (n, 2) and their inverse depths (n,)."""
        L = np.zeros((2, 2, 6))
        for i, (X, Y, W) in enumerate(self._compute_directions(points)):
            a = np.hypot(X, Y)
            by_direction = np.array([
                [-W * X / a**3, -W * Y / a**3, 1.0 / a], [-Y / a**2, X / a**2, 0.0]
            ])  # fmt: skip
            L[i, :, 3:] = by_direction @ skew((X, Y, W))
        return L.reshape(-1, 6)

    @staticmethod
    def _compute_directions(points: np.ndarray) -> np.ndarray:
        """Return the unit directions (2, 3) of the two pairs of sides in the camera frame.

        The first pair consists of the sides 0-1 and 3-2 between the points 0 to 3, the second pair
        of the sides 1-2 and 0-3.
        """
        if len(points) != 4:
            raise MeasurementError(
                "vanishing points need the four corners of a parallelogram, but the target has "
                f"{len(points)} corners; use another target or feature"
            )
        p = np.column_stack([points, np.ones(4)])
        found = []
        for a, b, c, d in ((0, 1, 3, 2), (1, 2, 0, 3)):
            one, other = np.cross(p[a], p[b]), np.cross(p[c], p[d])
            meet = np.cross(one, other)
            # The sign of this product says whether the vector along the side in the image points
            # towards the vanishing point (positive) or away from it.
            sign = (meet[:2] - p[a, :2] * meet[2]) @ (p[b, :2] - p[a, :2])
            size = np.linalg.norm(meet)
            same_line = size <= MIN_LENGTH * np.linalg.norm(one) * np.linalg.norm(other)
            if same_line or np.hypot(meet[0], meet[1]) < MIN_LENGTH * size:
                raise MeasurementError(
                    "two opposite sides of the target appear on one line and have no vanishing "
                    "point; move the camera out of the target's plane"
                )
            found.append(meet * np.sign(sign) / size)
        return np.array(found)
