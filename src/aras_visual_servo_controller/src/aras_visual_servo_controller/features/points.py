"""Points of the target in the image: corners as segmented, or by a user's own image processing.

s = (x_0, y_0, x_1, y_1, ...) in normalised coordinates; for each point, with its depth Z,

    L = [-1/Z  0    x/Z  xy      -(1+x^2)   y]
        [ 0   -1/Z  y/Z  1+y^2   -xy       -x]

Reference: F. Chaumette and S. Hutchinson, Visual servo control, part I, IEEE Robotics and
Automation Magazine 13(4), 2006.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from math import sqrt
from typing import Any, ClassVar

import numpy as np

from aras_visual_servo_camera.contour import match_corners
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.interaction import Plane, point_interaction
from aras_visual_servo_camera.line_fits import compute_rms_deviation
from aras_visual_servo_camera.polygons import signed_area

from ..errors import POINT_BEHIND_CAMERA, ConfigurationError, MeasurementError
from ..goals.goal import Goal
from ..observation.observation import Need, Observation
from .base import FEATURES, Feature, FeatureMeasurement, get_plane

# Of a goal that this camera has shown, image and goal are measured with nearly the same errors.
# They differ by NEARLY of a pixel, and CHANGING of the distance by which the points are off.
# Measured on corners of targets 8 to 40 px wide, 0.001 to 0.3 px off: 0.0025 px and 0.15 of the
# distance; of 120 arrivals, six tenths of that bounds their errors.
SHARED_PIXEL_ERROR, SHARED_DISTANCE_ERROR = 0.0012, 0.085
# Times the corners' spread by their sides, at a distance of one pixel; it grows with the distance's
# root, from NEAREST px on. Measured on 1 092 rendered pairs of goal and image, 0.001 to 0.3 px off:
# of markers and of outlines of 10 to 110 px, the camera's offset by them is 0.7 to 1.7 times what
# this expects, rms, and 2.0 times by outlines of 26 px that are 0.1 to 0.3 px off.
DEVIATION_FACTOR, MIN_DISTANCE = 1.5, 0.006
TOLERANCE = 0.001  # 0.1 pixel of a camera with f = 100, 0.2 mm at 0.2 m


class PointFeature(Feature):
    """A feature made of image points: base class for points found by your own image processing.

    A subclass gives `points`; s, s*, e and L follow. The goal's points are those that `teach` kept
    under this feature's name. If `ordered` is False and the points are not a marker's, they are
    matched to the goal's as an outline, by turning round.

    Attributes:
        ordered: whether `points` always returns the same point first.
        count: number of points; taken from the goal when it is checked.
    """

    is_ordered: ClassVar[bool] = True

    def __init__(self, count: int = 4) -> None:
        self._set_count(count)
        self.reset()

    @abstractmethod
    def points(self, observation: Observation) -> np.ndarray:
        """The points (n, 2) in this image, normalised coordinates.

        Raises:
            MeasurementError: they are not to be seen.
        """

    def reset(self) -> None:
        """Forget earlier images."""
        self._match_rotation = 0.0

    def check(self, goal: Goal) -> None:
        """Refuse a goal that this feature cannot servo to."""
        corners = self.read_desired_points(goal)
        self._set_count(len(corners))
        if goal.depth is None and goal.plane is None:
            raise ConfigurationError(f"{goal.name} does not say the target's depth (m)")

    def teach(self, observation: Observation) -> Mapping[str, Any]:
        """Return the data of the view at the goal that the goal file stores."""
        return {"points": np.asarray(self.points(observation), float).tolist()}

    def read_desired_points(self, goal: Goal) -> np.ndarray:
        """The goal's points (n, 2).

        Raises:
            ConfigurationError: the goal holds none of this feature.
        """
        taught = goal.features.get(self.name or type(self).__name__, {}).get("points")
        try:
            points = np.array(taught, float)
        except (TypeError, ValueError):
            points = np.zeros(())
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3:
            raise ConfigurationError(
                f"{goal.name} holds no points of the feature '{self.name or type(self).__name__}'"
                ": teach it (rosrun aras_visual_servo_controller teach --scheme ...)"
            )
        if not np.isfinite(points).all():
            raise ConfigurationError(f"{goal.name}: a point is not finite")
        return points

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """Measure s, s*, the error and L in one image."""
        desired = self.read_desired_points(goal)
        points, up_to = self._match_to_goal(observation, desired)
        inverse_depth = compute_inverse_depth(get_plane(observation), points)
        s, goal_s = points.ravel(), desired.ravel()
        return FeatureMeasurement(s, goal_s, s - goal_s, point_interaction(points, inverse_depth),
                        ambiguity=up_to)  # fmt: skip

    def desired_interaction(self, goal: Goal) -> np.ndarray:
        """Return the interaction matrix L (k, 6) at the goal."""
        desired = self.read_desired_points(goal)
        return point_interaction(desired, self._compute_goal_inverse_depth(goal, desired))

    def accuracy(self, observation: Observation, goal: Goal) -> np.ndarray | None:
        """Return the accuracy of s in the image measured last."""
        if not observation.corner_accuracy:
            return None
        desired = self.read_desired_points(goal)
        points = self._match_to_goal(observation, desired)[0]
        return estimate_corner_accuracy(observation, goal, points, desired)

    def _set_count(self, count: int) -> None:
        self.count = count
        self.names = tuple(f"{axis}{i}" for i in range(count) for axis in "xy")
        self.tolerances = (TOLERANCE,) * (2 * count)
        self.units = ("",) * (2 * count)

    @staticmethod
    def _compute_goal_inverse_depth(goal: Goal, desired: np.ndarray) -> np.ndarray:
        """1/Z (n,) of the goal's points, 1/m."""
        try:
            return compute_inverse_depth(goal.plane or Plane.fronto_parallel(goal.depth), desired)
        except MeasurementError as error:
            raise ConfigurationError(
                f"{goal.name}: {error}, where that is believed to be mounted: check the camera's "
                "place (believed, camera_xyz, camera_rpy) and the goal"
            ) from error

    def _match_to_goal(
        self, observation: Observation, desired: np.ndarray
    ) -> tuple[np.ndarray, str]:
        """Points (n, 2) in the order of the goal's, and what stays ambiguous.

        Raises:
            MeasurementError: another number of points, or one that is not finite.
        """
        points = self._check_count(observation, desired)
        known = self.is_ordered or observation.is_numbered
        return (points, "") if known else self._match_outline(points, desired)

    def _check_count(self, observation: Observation, desired: np.ndarray) -> np.ndarray:
        """The points (n, 2), as many as are desired.

        Corners of an outline that have become more or fewer, as those of a target far away do, are
        looked for again where the goal's would be.

        Raises:
            MeasurementError: another number of points, or one that is not finite.
        """
        points = np.asarray(self.points(observation), float)
        if not np.isfinite(points).all():
            raise MeasurementError("a point of the target is not finite")
        if points.shape == desired.shape:
            return points
        told = f"{len(np.atleast_1d(points))} points are seen, the goal has {len(desired)}"
        if points is not observation.corners or observation.contour is None:
            raise MeasurementError(told)
        try:
            return match_corners(observation.contour, desired)
        except VisionError as error:
            raise MeasurementError(f"{told}; {error}") from error

    def _match_outline(self, points: np.ndarray, desired: np.ndarray) -> tuple[np.ndarray, str]:
        """Points (n, 2) of an outline in the order of the goal's, and what stays ambiguous.

        Each of the n ways round is fitted by a similarity; of those that fit as well as the best,
        the one nearest to the last turn.
        """
        z, g = (p[:, 0] + 1j * p[:, 1] for p in (points, desired))
        z, g = z - z.mean(), g - g.mean()
        if signed_area(points) * signed_area(desired) < 0.0:
            points, z = points[::-1], z[::-1]
        size = float(np.vdot(z, z).real)
        round_twice = np.concatenate((z, z))
        fits = np.array([np.vdot(g, round_twice[k : k + len(z)]) for k in range(len(z))])
        residual = size - np.abs(fits) ** 2 / float(np.vdot(g, g).real)
        good = np.flatnonzero(residual <= residual.min() + 0.02 * size)
        turns = np.angle(fits[good])
        chosen = int(np.argmin(np.abs(np.angle(np.exp(1j * (turns - self._match_rotation))))))
        self._match_rotation = float(turns[chosen])
        up_to = "" if len(good) == 1 else f"{360 / len(good):.0f}°"
        return np.roll(points, -int(good[chosen]), axis=0), up_to


@FEATURES.register("points")
class Points(PointFeature):
    """The corners of the segmented target's outline: s = (x_0, y_0, x_1, ...), normalised."""

    needs = frozenset((Need.CORNERS,))
    is_ordered: ClassVar[bool] = False

    def points(self, observation: Observation) -> np.ndarray:
        """Return the points (n, 2) in this image, in normalised coordinates."""
        if observation.corners is None:
            raise MeasurementError("no corners in this observation: is the target a polygon?")
        return observation.corners


def compute_inverse_depth(plane: Plane, points: np.ndarray) -> np.ndarray:
    """1/Z (n,) of the plane at points (n, 2).

    Raises:
        MeasurementError: it lies behind the camera there.
    """
    inverse = plane.A * points[:, 0] + plane.B * points[:, 1] + plane.C
    if not (inverse > 0.0).all():
        raise MeasurementError(POINT_BEHIND_CAMERA)
    return inverse


def estimate_corner_accuracy(
    observation: Observation, goal: Goal, points: np.ndarray, desired: np.ndarray
) -> np.ndarray:
    """How exactly corners are known beside their goal's, as of Feature.accuracy, (2n, m).

    points, desired: (n, 2) of image and goal, in the same order, normalised.
    """
    accuracy, alone = observation.corner_accuracy, np.eye(points.size)
    if goal.camera != observation.camera:
        return accuracy * alone
    away, fx = float(np.mean((points - desired) ** 2)), observation.camera.K[0]
    spread = _spread(observation, points)
    if spread is None:
        common = SHARED_PIXEL_ERROR / fx + SHARED_DISTANCE_ERROR * sqrt(away)
        return max(min(accuracy, common), observation.corner_repeatability) * alone
    # Noise moves the corners as well, by no more than that.
    deviation = compute_rms_deviation(spread)
    away = fx * sqrt(max(away - deviation**2, 0.0))
    return min(DEVIATION_FACTOR * sqrt(max(away, MIN_DISTANCE)), accuracy / deviation) * spread


def _spread(observation: Observation, points: np.ndarray) -> np.ndarray | None:
    """The corners' spread (2n, m), as points (n, 2) are ordered; None where they are others."""
    if observation.corner_spread is None or observation.corner_spread.size == 0:
        return None
    same = (points[:, None] == observation.corners).all(axis=2)
    if not same.any(axis=1).all():
        return None
    rows = 2 * same.argmax(axis=1)
    return observation.corner_spread[np.column_stack([rows, rows + 1]).ravel()]


def backproject(points: np.ndarray, inverse_depth: np.ndarray) -> np.ndarray:
    """Points (n, 3) in the camera's frame, m, of (n, 2), normalised, with 1/Z (n,), 1/m."""
    return np.column_stack([points, np.ones(len(points))]) / np.asarray(inverse_depth)[:, None]
