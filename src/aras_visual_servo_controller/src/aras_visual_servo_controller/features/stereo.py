"""Features of two cameras: triangulated points, and the pose that is computed from them.

The depth follows from the poses of the two cameras alone, without a plane or a model of the target.
Reference: F. Chaumette, S. Hutchinson and P. Corke, Visual servoing, Springer Handbook of Robotics,
2016, 34.4.2 (stereo).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import scipy.linalg

from aras_visual_servo_base.poses import relative_pose, skew

from ..errors import ConfigurationError, MeasurementError
from ..goals.goal import Goal
from ..observation.observation import Need, Observation
from .base import FEATURES, Feature, FeatureMeasurement
from .corners import POINT_TOLERANCES, NumberedPoints
from .points import estimate_corner_accuracy
from .pose import PLANARITY_TOLERANCE, PoseInGoalFrame, compute_goal_frame_feature

# Smallest distance between the two cameras, relative to their distance from the target. With a
# smaller one the disparity is too small to measure depth.
MIN_DISPARITY = 2e-3
STEP = 1e-6  # step of finite differences, in normalised coordinates


@FEATURES.register("stereo_points")
class StereoPoints(Feature):
    """s = (X, Y, Z) of each corner in the frame of the first of two cameras, m; L = [-1  [X]x]."""

    needs = frozenset((Need.CORNERS,))
    camera_count: ClassVar[int] = 2

    def __init__(self) -> None:
        self._point_features = tuple(NumberedPoints() for _ in range(self.camera_count))
        self._set_count(4)

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """Measure s, s*, the error and L in one image."""
        first = observation.cameras[self.cameras[0]]
        points, ambiguity = self._match_points(observation, goal)
        places = triangulate(*points, self._compute_relative_pose(observation.cameras))
        s, L, desired = self.compute_from_points(places, self._triangulate_goal(goal))
        since = first.compute_change_since_exposure(L)
        return FeatureMeasurement(
            s + since, desired, s + since - desired, first.transform_to_control(L),
            ambiguity=ambiguity,
        )  # fmt: skip

    def compute_from_points(
        self, points: np.ndarray, desired_points: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Compute s (k,), L (k, 6) and s* (k,).

        Args:
            points: (n, 3) points in the frame of the first camera, m.
            desired_points: (n, 3) these points at the goal, m.
        """
        L = np.vstack([np.hstack([-np.eye(3), skew(place)]) for place in points])
        return points.ravel(), L, desired_points.ravel()

    def accuracy(self, observation: Observation, goal: Goal) -> np.ndarray | None:
        """Return the accuracy of s, propagated from that of the image points by finite differences.
        """
        views = [observation.cameras[name] for name in self.cameras]
        if not any(view.corner_accuracy for view in views):
            return None
        desired, between = self._triangulate_goal(goal), self._compute_relative_pose(goal.cameras)
        points = np.stack(self._read_goal_points(goal))
        matched = self._match_points(observation, goal)[0]
        accuracy = scipy.linalg.block_diag(*(
            estimate_corner_accuracy(view, goal.cameras[view.name], *pair)
            for view, *pair in zip(views, matched, points, strict=True)
        ))
        at_goal = self.compute_from_points(triangulate(*points, between), desired)[0]
        effects = []
        for i in np.ndindex(points.shape):
            moved = points.copy()
            moved[i] += STEP
            s = self.compute_from_points(triangulate(*moved, between), desired)[0]
            effects.append((s - at_goal) / STEP)
        return np.transpose(effects) @ accuracy

    def check(self, goal: Goal) -> None:
        """Refuse a goal that this feature cannot servo to."""
        for name in self.cameras:
            if name not in goal.cameras:
                raise ConfigurationError(
                    f"{goal.name} has no view of camera '{name}': teach it with this scheme"
                )
        apart = float(np.linalg.norm(self._compute_relative_pose(goal.cameras)[:3, 3]))
        if apart < MIN_DISPARITY * goal.distance:
            raise ConfigurationError(
                f"{self.name}: cameras {' and '.join(self.cameras)} are {1e3 * apart:.1f} mm apart"
                ", too close to measure depth: move one of them"
            )
        self._set_count(len(self._triangulate_goal(goal)))

    def teach(self, observation: Observation) -> Mapping[str, Any]:
        """Return the data that the goal file stores for this feature, from the view at the goal."""
        views = [observation.cameras[name] for name in self.cameras]
        found = [n.points(v) for n, v in zip(self._point_features, views, strict=True)]
        # If both cameras see the same number of points, those of the second camera are stored in
        # the order of those of the first camera.
        if len(found[0]) == len(found[1]):
            found[1] = self._point_features[1]._match_to_goal(views[1], found[0])[0]
        return {"points": [np.asarray(points, float).tolist() for points in found]}

    def reset(self) -> None:
        """Forget earlier images."""
        for numbering in self._point_features:
            numbering.reset()

    def _set_count(self, count: int) -> None:
        self.names = tuple(f"{axis}{i}" for i in range(count) for axis in "XYZ")
        self.tolerances, self.units = POINT_TOLERANCES * count, ("m",) * (3 * count)

    def _compute_relative_pose(
        self, views: Mapping[str, Observation] | Mapping[str, Goal]
    ) -> np.ndarray:
        """Compute the pose second_T_first (4, 4) of the first camera in the second camera's frame.

        Each camera is taken at the exposure of its own image.

        Args:
            views: observation or goal of each camera, by camera name.
        """
        first, second = (views[name].world_T_camera for name in self.cameras)
        return relative_pose(second, first)

    def _read_goal_points(self, goal: Goal) -> list[np.ndarray]:
        """Return the goal's points (n, 2) of each camera."""
        taught = goal.features.get(self.name, {}).get("points", ())
        shapes = {np.shape(points) for points in taught}
        if len(taught) != self.camera_count or len(shapes) != 1 or len(min(shapes)) != 2:
            raise ConfigurationError(
                f"{goal.name} holds no points of two cameras: teach it with {self.name}"
            )
        return [np.array(points, float) for points in taught]

    def _triangulate_goal(self, goal: Goal) -> np.ndarray:
        """Triangulate the goal's points; return them (n, 3) in the first camera's frame, m."""
        try:
            return triangulate(
                *self._read_goal_points(goal), self._compute_relative_pose(goal.cameras)
            )
        except MeasurementError as error:
            raise ConfigurationError(f"{goal.name}: {error}") from error

    def _match_points(self, observation: Observation, goal: Goal) -> tuple[np.ndarray, str]:
        """Return the points (2, n, 2) of both cameras in the goal's order, and their ambiguity.

        The ambiguity is the rotation by which the order is ambiguous, as text ('180°'); empty if
        none.
        """
        found, ambiguities = [], []
        views = (observation.cameras[name] for name in self.cameras)
        for numbering, view, goal_points in zip(
            self._point_features, views, self._read_goal_points(goal), strict=True
        ):
            points, ambiguity = numbering._match_to_goal(view, goal_points)
            found.append(points)
            ambiguities.append(ambiguity)
        return np.stack(found), min(ambiguities)


@FEATURES.register("stereo_pose")
class StereoPose(StereoPoints):
    """Position-based servoing on two cameras: s = (g_t_c, theta u), as for the feature `pose`.

    The pose is the rigid motion between the triangulated points of the goal and of the image.
    """


    def compute_from_points(
        self, points: np.ndarray, desired_points: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Compute s (k,), L (k, 6) and s* (k,) from points (n, 3) and desired points (n, 3), m."""
        s, L = compute_goal_frame_feature(estimate_rigid_motion(desired_points, points))
        return s, L, np.zeros(6)

    def _set_count(self, count: int) -> None:
        self.names, self.tolerances, self.units = zip(*PoseInGoalFrame.components, strict=True)


def triangulate(first: np.ndarray, second: np.ndarray, second_T_first: np.ndarray) -> np.ndarray:
    """Triangulate points; return them (n, 3) in the first camera's frame, m.

    Each point is the least-squares solution of x Z = X and y Z = Y in both cameras.

    Args:
        first, second: (n, 2) normalised image points of the two cameras.
        second_T_first: (4, 4) pose of the first camera in the second camera's frame.

    Raises:
        MeasurementError: a point is behind a camera, for example after a wrong match.
    """
    R, t = second_T_first[:3, :3], second_T_first[:3, 3]
    places = np.empty((len(first), 3))
    for i, ((x, y), (u, v)) in enumerate(zip(first, second, strict=True)):
        rows = np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], R[0] - u * R[2], R[1] - v * R[2]])
        right = np.array([0.0, 0.0, u * t[2] - t[0], v * t[2] - t[1]])
        places[i] = np.linalg.lstsq(rows, right, rcond=None)[0]
    if not (places[:, 2] > 0.0).all() or not (places @ R[2] + t[2] > 0.0).all():
        raise MeasurementError(
            "a point that is visible in two cameras lies behind one of them: the points of the two "
            "images may have been matched incorrectly"
        )
    return places


def estimate_rigid_motion(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Compute a_T_b (4, 4), which maps `before` (n, 3) to `after` (n, 3) by least squares (Kabsch).

    Raises:
        MeasurementError: the points are collinear, or all coincide.
    """
    middle, other = before.mean(axis=0), after.mean(axis=0)
    U, sizes, Vt = np.linalg.svd(before.T @ (after - other))
    if not sizes[1] > PLANARITY_TOLERANCE * sizes[0]:
        raise MeasurementError(
            "the points of the target lie on one line: they give no pose; use other points"
        )
    a_T_b = np.eye(4)
    a_T_b[:3, :3] = Vt.T @ np.diag([1.0, 1.0, np.linalg.det(Vt.T @ U.T)]) @ U.T
    a_T_b[:3, 3] = other - a_T_b[:3, :3] @ middle
    return a_T_b
