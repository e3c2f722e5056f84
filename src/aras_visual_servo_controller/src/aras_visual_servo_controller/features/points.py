"""Image points of the target: corners of the segmented outline, or user-defined points.

s = (x_0, y_0, x_1, y_1, ...) in normalised coordinates. Each point, with its depth Z, contributes
two rows to the interaction matrix:

    L = [-1/Z  0    x/Z  xy      -(1+x^2)   y]
        [ 0   -1/Z  y/Z  1+y^2   -xy       -x]

Reference: F. Chaumette and S. Hutchinson, Visual servo control, part I, IEEE Robotics and
Automation Magazine 13(4), 2006.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from math import hypot, sqrt
from typing import Any, ClassVar

import numpy as np

from aras_visual_servo_base.compiled import jit
from aras_visual_servo_camera.contour import match_corners
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.interaction import (
    Plane,
    point_interaction,
    write_plane_point_interaction,
)
from aras_visual_servo_camera.intersection_accuracy import compute_rms_deviation

from ..errors import POINT_BEHIND_CAMERA, ConfigurationError, MeasurementError
from ..goals.goal import Goal
from ..kinematics.algebra import is_finite
from ..observation.observation import Need, Observation
from .base import FEATURES, Feature, FeatureMeasurement, get_plane

# Corner errors of goal and image are nearly equal if the same camera measured both. Their
# difference is modelled as SHARED_PIXEL_ERROR (px) plus SHARED_DISTANCE_ERROR times the mean
# distance (px) between the points of image and goal. Targets 8 to 40 px wide gave 0.0025 px and
# 0.15. Half of these values is used, which was enough to bound the final errors of 120 runs.
SHARED_PIXEL_ERROR, SHARED_DISTANCE_ERROR = 0.0012, 0.085
# Model of the difference between the corner errors of goal and image if the same camera measured
# both: DEVIATION_FACTOR sqrt(max(d, MIN_DISTANCE)) hypot(s, MIN_DEVIATION), in px. d is the
# distance between the points of image and goal, and s the deviation of edge points from the fitted
# sides; it is too small for a side along a row of pixels, hence MIN_DEVIATION. The factors were
# fitted to 183 runs without noise, on outlines of 10 to 240 px.
DEVIATION_FACTOR, MIN_DISTANCE, MIN_DEVIATION = 1.13, 0.002, 0.008
TOLERANCE = 0.001  # error in normalised coordinates: 0.1 px for f = 100 px, or 0.2 mm at 0.2 m


class PointFeature(Feature):
    """Base class of features made of image points, such as those of your own image processing.

    A subclass implements `points`; s, s*, e and L are computed from them. The goal's points are
    those that `teach` has stored under the name of the feature. If `is_ordered` is False and the
    points do not belong to a marker, they are treated as corners of a closed outline and matched to
    the goal's points up to a cyclic shift.

    Attributes:
        is_ordered: whether `points` returns the points in the same order for every image.
        count: number of points; set from the goal when the goal is checked.
    """

    is_ordered: ClassVar[bool] = True
    # Latest goal, and its points, which are cached for all images.
    _goal_points: tuple[Goal | None, np.ndarray] = (None, np.zeros(0))
    # Latest observation, the goal's points, and the result of `_match_to_goal` for them.
    _latest_match: tuple[Any, Any, Any] = (None, None, None)

    def __init__(self, count: int = 4) -> None:
        self._set_count(count)
        self.reset()

    @abstractmethod
    def points(self, observation: Observation) -> np.ndarray:
        """Return the points (n, 2) in this image, in normalised coordinates.

        Raises:
            MeasurementError: the points are not visible.
        """

    def reset(self) -> None:
        """Forget earlier images."""
        self._match_rotation = 0.0
        self._latest_match = (None, None, None)

    def check(self, goal: Goal) -> None:
        """Refuse a goal that this feature cannot servo to."""
        corners = self.read_desired_points(goal)
        self._set_count(len(corners))
        goal.check_depth(plane_suffices=True)

    def teach(self, observation: Observation) -> Mapping[str, Any]:
        """Return the data that the goal file stores for this feature, from the view at the goal."""
        return {"points": np.asarray(self.points(observation), float).tolist()}

    def read_desired_points(self, goal: Goal) -> np.ndarray:
        """Return the goal's points (n, 2), in normalised coordinates.

        Raises:
            ConfigurationError: the goal contains no points of this feature.
        """
        if self._goal_points[0] is goal:
            return self._goal_points[1]
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
            raise ConfigurationError(f"{goal.name}: a point is not finite; teach the goal again")
        points.setflags(write=False)
        self._goal_points = goal, points
        return points

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """Measure s, s*, the error and L in one image."""
        desired = self.read_desired_points(goal)
        points, ambiguity = self._match(observation, desired)
        plane, L = observation.plane or get_plane(observation), np.empty((points.size, 6))
        if not write_plane_point_interaction(points, *plane, L):
            raise MeasurementError(POINT_BEHIND_CAMERA)
        s, goal_s = points.ravel(), desired.ravel()
        return FeatureMeasurement(s, goal_s, s - goal_s, L, ambiguity=ambiguity)

    def desired_interaction(self, goal: Goal) -> np.ndarray:
        """Return the interaction matrix L (k, 6) at the goal."""
        desired = self.read_desired_points(goal)
        return point_interaction(desired, self._compute_goal_inverse_depth(goal, desired))

    def accuracy(self, observation: Observation, goal: Goal) -> np.ndarray | None:
        """Return the accuracy of s in the latest image."""
        if not observation.corner_accuracy:
            return None
        desired = self.read_desired_points(goal)
        points = self._match(observation, desired)[0]
        return estimate_corner_accuracy(observation, goal, points, desired)

    def _set_count(self, count: int) -> None:
        self.count = count
        self.names = tuple(f"{axis}{i}" for i in range(count) for axis in "xy")
        self.tolerances = (TOLERANCE,) * (2 * count)
        self.units = ("",) * (2 * count)

    @staticmethod
    def _compute_goal_inverse_depth(goal: Goal, desired: np.ndarray) -> np.ndarray:
        """Compute the inverse depth 1/Z (n,) of the goal's points, 1/m."""
        try:
            return compute_inverse_depth(goal.plane or Plane.fronto_parallel(goal.depth), desired)
        except MeasurementError as error:
            raise ConfigurationError(
                f"{goal.name}: {error} according to the assumed camera mounting; check the "
                "camera's pose (camera_xyz, camera_rpy) and the goal"
            ) from error

    def _match(self, observation: Observation, desired: np.ndarray) -> tuple[np.ndarray, str]:
        """Return the result of `_match_to_goal`, which is computed once for each image."""
        known = self._latest_match
        if known[0] is not observation or known[1] is not desired:
            found = self._match_to_goal(observation, desired)
            self._latest_match = known = observation, desired, found
        return known[2]

    def _match_to_goal(
        self, observation: Observation, desired: np.ndarray
    ) -> tuple[np.ndarray, str]:
        """Return the points (n, 2) in the goal's order, and the angle by which it is ambiguous.

        Raises:
            MeasurementError: the number of points differs from the goal's, or a coordinate is not
                finite.
        """
        points = self._check_count(observation, desired)
        known = self.is_ordered or observation.is_numbered
        return (points, "") if known else self._match_outline(points, desired)

    def _check_count(self, observation: Observation, desired: np.ndarray) -> np.ndarray:
        """Return the points (n, 2) of the image, as many as the goal has.

        The outline of a distant target may have another number of corners. Then the corners are
        searched for again near their expected positions.

        Raises:
            MeasurementError: the number of points differs from the goal's, or a coordinate is not
                finite.
        """
        points = np.asarray(self.points(observation), float)
        if not is_finite(points.ravel()):
            raise MeasurementError("the feature returned a point that is not finite; correct the "
                                   "feature")
        if points.shape == desired.shape:
            return points
        message = (
            f"{len(np.atleast_1d(points))} points are visible, but the goal has {len(desired)}"
        )
        if points is not observation.corners or observation.contour is None:
            raise MeasurementError(message)
        try:
            return match_corners(observation.contour, desired)
        except VisionError as error:
            raise MeasurementError(f"{message}; {error}") from error

    def _match_outline(self, points: np.ndarray, desired: np.ndarray) -> tuple[np.ndarray, str]:
        """Return outline points (n, 2) in the goal's order, and the angle by which it is ambiguous.

        Each of the n cyclic shifts is fitted by a similarity transform. If several shifts fit about
        equally well, the one whose rotation is nearest to that of the previous image is used. The
        angle between them is returned as text ('90°'); it is empty if only one shift fits.
        """
        matched = np.empty(points.shape)
        count, self._match_rotation = match_outline(points, desired, self._match_rotation, matched)
        return matched, "" if count == 1 else f"{360 / count:.0f}°"


@FEATURES.register("points")
class Points(PointFeature):
    """Corners of the segmented target's outline: s = (x_0, y_0, x_1, ...), normalised."""

    needs = frozenset((Need.CORNERS,))
    is_ordered: ClassVar[bool] = False

    def points(self, observation: Observation) -> np.ndarray:
        """Return the points (n, 2) in this image, in normalised coordinates."""
        if observation.corners is None:
            raise MeasurementError("this observation has no corners: use a polygon as the target")
        return observation.corners


@jit("f8[:,:], f8[:,:], f8, f8[:,::1]")
def match_outline(points, desired, last_rotation, matched):
    """Match the corners of an outline to those of the goal up to a cyclic shift.

    Args:
        points, desired: (n, 2) corners of the outline and of the goal, in order around them.
        last_rotation: rotation of the previous match, rad.
        matched: (n, 2) output, the points in the order of the goal's points.

    Returns:
        The number of shifts that fit about as well as the best one; the rotation, rad.
    """
    count = len(points)
    p, g = np.empty((count, 2)), np.empty((count, 2))
    for i in range(2):
        p_mean = g_mean = 0.0
        for k in range(count):
            p_mean, g_mean = p_mean + points[k, i], g_mean + desired[k, i]
        for k in range(count):
            p[k, i], g[k, i] = points[k, i] - p_mean / count, desired[k, i] - g_mean / count
    area = goal_area = size = goal_size = 0.0
    for k in range(count):
        after = k + 1 if k < count - 1 else 0
        area += p[k, 0] * p[after, 1] - p[k, 1] * p[after, 0]
        goal_area += g[k, 0] * g[after, 1] - g[k, 1] * g[after, 0]
        size += p[k, 0] ** 2 + p[k, 1] ** 2
        goal_size += g[k, 0] ** 2 + g[k, 1] ** 2
    is_reversed = area * goal_area < 0.0
    # For each cyclic shift of the points, fit z = a g, where the complex numbers z and g are the
    # points of image and goal. The factor a scales and rotates.
    residuals, rotations = np.empty(count), np.empty(count)
    for shift in range(count):
        real = imaginary = 0.0
        for k in range(count):
            at = (k + shift) % count
            if is_reversed:
                at = count - 1 - at
            real += g[k, 0] * p[at, 0] + g[k, 1] * p[at, 1]
            imaginary += g[k, 0] * p[at, 1] - g[k, 1] * p[at, 0]
        residuals[shift] = size - (real * real + imaginary * imaginary) / goal_size
        rotations[shift] = np.arctan2(imaginary, real)
    limit, best, least, found = residuals.min() + 0.02 * size, 0, np.inf, 0
    for shift in range(count):
        if residuals[shift] <= limit:
            found += 1
            change = rotations[shift] - last_rotation
            change = abs(np.arctan2(np.sin(change), np.cos(change)))
            if change < least:
                best, least = shift, change
    for k in range(count):
        at = (k + best) % count
        if is_reversed:
            at = count - 1 - at
        matched[k, 0], matched[k, 1] = points[at, 0], points[at, 1]
    return found, rotations[best]


def compute_inverse_depth(plane: Plane, points: np.ndarray) -> np.ndarray:
    """Compute the inverse depth 1/Z (n,) of the plane at points (n, 2).

    Raises:
        MeasurementError: a point is behind the camera.
    """
    inverse = plane.A * points[:, 0] + plane.B * points[:, 1] + plane.C
    if not all((inverse > 0.0).tolist()):
        raise MeasurementError(POINT_BEHIND_CAMERA)
    return inverse


def estimate_corner_accuracy(
    observation: Observation, goal: Goal, points: np.ndarray, desired: np.ndarray
) -> np.ndarray:
    """Estimate the accuracy (2n, m) of the differences between the corners of image and goal.

    Args:
        observation: observation with the accuracy of its corners.
        goal: goal with its camera.
        points, desired: (n, 2) points of image and goal, in the same order, normalised.
    """
    accuracy = observation.corner_accuracy
    if not (goal.camera is observation.camera or goal.camera == observation.camera):
        return accuracy * np.eye(points.size)
    squares, fx = (points - desired) ** 2, observation.camera.K[0]
    away = float(np.add.reduce(squares, axis=None)) / squares.size
    spread = _spread(observation, points)
    if spread is None:
        common = SHARED_PIXEL_ERROR / fx + SHARED_DISTANCE_ERROR * sqrt(away)
        deviation = max(min(accuracy, common), observation.corner_repeatability)
        return deviation * np.eye(points.size)
    # Noise increases the measured distance of the corners from the goal, so the noise's variance is
    # subtracted from the squared distance.
    deviation = compute_rms_deviation(spread)
    away = fx * sqrt(max(away - deviation**2, 0.0))
    enlarged = hypot(deviation, MIN_DEVIATION / fx)
    common = DEVIATION_FACTOR * sqrt(max(away, MIN_DISTANCE)) * enlarged
    return min(common, accuracy) / deviation * spread


def _spread(observation: Observation, points: np.ndarray) -> np.ndarray | None:
    """Return the effects (2n, m) of m independent errors on points (n, 2), in their order.

    Return None if the points are not the corners of the observation.
    """
    spread, rows = observation.corner_spread, np.empty(2 * len(points), np.int64)
    if spread is None or spread.size == 0:
        return None
    return spread[rows] if _find_rows(points, observation.corners, rows) else None


@jit("f8[:,:], f8[:,:], i8[::1]", allocates=False)
def _find_rows(points, corners, rows):
    """Find the corner (m, 2) that is equal to each point (n, 2).

    Write the rows (2n,) of the points' coordinates x_0, y_0, x_1, ... in an array with two rows for
    each corner. Return False if a point is not a corner.
    """
    for i in range(len(points)):
        k = 0
        while points[i, 0] != corners[k, 0] or points[i, 1] != corners[k, 1]:
            k += 1
            if k == len(corners):
                return False
        rows[2 * i], rows[2 * i + 1] = 2 * k, 2 * k + 1
    return True


def backproject(points: np.ndarray, inverse_depth: np.ndarray) -> np.ndarray:
    """Compute points (n, 3) in the camera frame, m.

    Args:
        points: (n, 2) image points, normalised.
        inverse_depth: (n,) inverse depths 1/Z of the points, 1/m.
    """
    return np.column_stack([points, np.ones(len(points))]) / np.asarray(inverse_depth)[:, None]
