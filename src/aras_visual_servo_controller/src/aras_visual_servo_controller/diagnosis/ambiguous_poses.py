"""Camera poses other than the goal from which the goal's points have the same image.

Three points have the same image from up to four poses (J. Grunert, 1841). Coplanar points have
nearly the same image from the pose with the mirrored tilt, and the difference decreases with the
focal length (T. Collins and A. Bartoli, Infinitesimal plane-based pose estimation, IJCV 109, 2014).
If kinematics give the plane of the target, this plane shows at which of these poses the camera is.
Otherwise the poses are distinguished by the image, if it differs enough between them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from aras_visual_servo_base.poses import inverse, pose_difference
from aras_visual_servo_camera.interaction import Plane, point_interaction

from ..errors import MeasurementError
from ..features.points import backproject
from ..features.pose import are_collinear, refine_pose
from ..goals.goal import Goal
from ..observation.observation import Observation

# At an ambiguous pose, the target's points have almost the same image as at the goal. No image
# point differs from its position at the goal by more than MAX_POINT_DISTANCE or MAX_RADIUS_PART, so
# the features may count as converged.
MAX_POINT_DISTANCE = 5e-3  # distance between two image points, normalised
MAX_RADIUS_PART = 0.1  # distance between two image points, in radii of the target's image
# Two poses are the same if they differ by less than this: translation as a fraction of the depth,
# rotation in rad.
SAME_POSE = 2e-3
# If the target plane in the camera frame differs by less than this between a pose and the goal, the
# pose is not listed as ambiguous: the camera has only turned about the target's normal, and the
# target is symmetric. The difference is an angle (rad) plus the logarithm of a distance ratio.
SAME_PLANE = 0.02
# Kinematics predict the target's plane in the camera frame. To decide between two poses, this plane
# is compared with the plane at each pose. A pose is chosen if its difference is less than this
# fraction of the other pose's difference.
NEARER_FACTOR = 0.5
# The image decides between two poses if the sums of their squared image errors differ by more than
# this many variances of a measured corner position.
MIN_FIT_DIFFERENCE = 25.0
EXACT_ACCURACY = 1e-6  # standard deviation assumed for exact image points, normalised
# largest residual when an affine map is fitted to the goal's points, in radii of the target
AFFINE_TOLERANCE = 0.1


@dataclass(frozen=True, eq=False)
class AmbiguousPose:
    """A camera pose from which the goal's points have the same image as from the goal.

    Attributes:
        points: (n, 2) normalised image points at this pose, in the order of the goal's points.
        inverse_depth: (n,) inverse depths of these points, 1/m.
        plane: (3,) target plane in the camera's frame at this pose, see `Plane`.
        distance: distance of this pose from the goal, m.
        angle: angle between this pose and the goal, rad.
    """

    points: np.ndarray
    inverse_depth: np.ndarray
    plane: np.ndarray
    distance: float
    angle: float


class AmbiguousPoses:
    """All ambiguous poses of one goal, computed once."""

    def __init__(self, goal: Goal) -> None:
        self.goal = goal
        self._points, self.poses = np.zeros((0, 2)), ()
        sets = [np.array(one["points"], float) for one in goal.features.values()
                  if "points" in one]  # fmt: skip
        if goal.other_cameras or not sets or sets[0].ndim != 2 or len(sets[0]) < 3:
            return
        self._plane = np.array(goal.plane or Plane.fronto_parallel(goal.distance))
        self._points = points = sets[0]
        self._inverse_depth = np.column_stack([points, np.ones(len(points))]) @ self._plane
        if (self._inverse_depth > 0.0).all() and not are_collinear(points):
            self.poses = tuple(self._find_poses())

    def find_pose(
        self, observation: Observation
    ) -> tuple[AmbiguousPose | None, tuple[AmbiguousPose, ...]]:
        """Find the ambiguous pose at which the camera is.

        Returns:
            The pose, or None if the camera is at none of them; all ambiguous poses that neither the
            target's plane nor the image can distinguish from the goal.
        """
        possible, nearest, least = [], None, np.inf
        for pose in self.poses:
            here, there = 1.0, 1.0
            if observation.plane is not None:
                plane = np.array(observation.plane)
                here = _compare_planes(plane, self._plane)
                there = _compare_planes(plane, pose.plane)
            if here < NEARER_FACTOR * there:
                continue
            if there >= NEARER_FACTOR * here:
                better = self._compare_fit(observation, pose)
                if better < -MIN_FIT_DIFFERENCE:
                    continue
                if better <= MIN_FIT_DIFFERENCE:
                    possible.append(pose)
                    continue
            if there < least:
                nearest, least = pose, there
        return nearest, tuple(possible)

    def _compare_fit(self, observation: Observation, pose: AmbiguousPose) -> float:
        """Return by how much better the image fits this pose than the goal.

        The result is the squared image error at the goal minus that at the pose, divided by the
        variance of a measured corner position. It is 0 if the corners cannot be matched with the
        goal's points.
        """
        corners = _match_corners(observation.corners, self._points)
        if corners is None:
            return 0.0
        accuracy = max(observation.with_noise().corner_accuracy, EXACT_ACCURACY)
        at_goal = _compute_residual(corners, self._points, self._inverse_depth)
        at_pose = _compute_residual(corners, pose.points, pose.inverse_depth)
        return (at_goal - at_pose) / accuracy**2

    def _find_poses(self) -> Iterator[AmbiguousPose]:
        """Yield each ambiguous pose once."""
        points, known = self._points, [np.eye(4)]
        goal_points = backproject(points, self._inverse_depth)
        radius = float(np.sqrt(points.var(axis=0).sum()))
        close = min(MAX_POINT_DISTANCE, MAX_RADIUS_PART * radius)
        flat = np.column_stack([points, np.ones(len(points))])
        # The points in each cyclic order (n, n, 2), and their nearest affine images of `points`.
        orders = np.add.outer(np.arange(len(points)), np.arange(len(points))) % len(points)
        shifted_points = points[orders]
        affine_images = flat @ np.linalg.pinv(flat) @ shifted_points
        distances = np.abs(shifted_points - affine_images).max(axis=(1, 2))
        for shift in np.flatnonzero(distances <= AFFINE_TOLERANCE * radius).tolist():
            shifted = shifted_points[shift]
            for c_T_g in _solve_poses(goal_points, shifted):
                # The goal and a pose that has already been found need no refinement.
                if self._is_known(c_T_g, known):
                    continue
                try:
                    c_T_g = refine_pose(c_T_g[:3, :3], c_T_g[:3, 3], goal_points, shifted)
                except (MeasurementError, np.linalg.LinAlgError):
                    continue
                X = goal_points @ c_T_g[:3, :3].T + c_T_g[:3, 3]
                if not (X[:, 2] > 0.0).all():
                    continue
                projected = X[:, :2] / X[:, 2:]
                if np.abs(projected - shifted).max() > close:
                    continue
                if self._is_known(c_T_g, known):
                    continue
                known.append(c_T_g)
                normal = c_T_g[:3, :3] @ self._plane
                plane = normal / (1.0 + normal @ c_T_g[:3, 3])
                if _compare_planes(plane, self._plane) > SAME_PLANE:
                    distance, angle = pose_difference(np.eye(4), inverse(c_T_g))
                    order = np.roll(np.arange(len(points)), shift)
                    yield AmbiguousPose(
                        projected[order], (1.0 / X[:, 2])[order], plane, distance, angle
                    )

    def _is_known(self, pose: np.ndarray, known: Sequence[np.ndarray]) -> bool:
        """Return whether a pose (4, 4) differs from one of the known poses by less than SAME_POSE.
        """
        differences = (pose_difference(pose, one) for one in known)
        return any(
            distance / self.goal.distance + angle < SAME_POSE for distance, angle in differences
        )


def _solve_poses(places: np.ndarray, points: np.ndarray) -> Iterator[np.ndarray]:
    """Yield approximate camera poses c_T_g (4, 4) that project coplanar points to image points.

    Args:
        places: (n, 3) coplanar points in frame g, m.
        points: (n, 2) their normalised image points.
    """
    centre = places.mean(axis=0)
    about = np.ascontiguousarray(places - centre)[:, None]
    image, size = np.ascontiguousarray(points)[:, None], float(np.abs(about).max())
    if len(points) == 3:
        _, rotations, translations = cv2.solveP3P(
            about / size, image, np.eye(3), None, cv2.SOLVEPNP_P3P
        )
    else:
        _, rotations, translations, _ = cv2.solvePnPGeneric(
            about / size, image, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
        )
    for rotation, translation in zip(rotations, translations, strict=True):
        c_T_g = np.eye(4)
        c_T_g[:3, :3] = R = cv2.Rodrigues(rotation)[0]
        c_T_g[:3, 3] = size * np.ravel(translation) - R @ centre
        yield c_T_g


def _compare_planes(one: np.ndarray, other: np.ndarray) -> float:
    """Return the difference of two planes (3,): angle (rad) plus logarithm of the distance ratio.
    """
    sizes = np.linalg.norm(one), np.linalg.norm(other)
    cosine = float(np.clip(one @ other / (sizes[0] * sizes[1]), -1.0, 1.0))
    return float(np.arccos(cosine) + abs(np.log(sizes[0] / sizes[1])))


def _match_corners(corners: np.ndarray | None, points: np.ndarray) -> np.ndarray | None:
    """Return the corner nearest to each of the points (n, 2), as an array (n, 2).

    Return None if a point has no corner nearby, or if two points share their nearest corner.
    """
    if corners is None or len(corners) < len(points):
        return None
    distances = np.linalg.norm(np.asarray(corners)[None] - points[:, None], axis=2)
    nearest = distances.argmin(axis=1)
    if (
        len(set(nearest.tolist())) < len(points)
        or distances.min(axis=1).max() > 2.0 * MAX_POINT_DISTANCE
    ):
        return None
    return np.asarray(corners)[nearest]


def _compute_residual(
    image_points: np.ndarray, points: np.ndarray, inverse_depth: np.ndarray
) -> float:
    """Return the sum of squared image errors that remains after the best small camera motion.

    Args:
        image_points: (n, 2) measured normalised image points.
        points: (n, 2) expected normalised image points.
        inverse_depth: (n,) inverse depths of the expected points, 1/m.
    """
    L, error = point_interaction(points, inverse_depth), (image_points - points).ravel()
    rest = error - L @ np.linalg.lstsq(L, error, rcond=None)[0]
    return float(rest @ rest)
