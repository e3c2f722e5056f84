"""Other poses of the camera from which a goal's points look as they do at the goal.

Three points look the same from up to four poses (J. Grunert, 1841). Points of a plane look nearly
the same from the pose whose tilt is mirrored, the more so the longer the lens (T. Collins and A.
Bartoli, Infinitesimal plane-based pose estimation, IJCV 109, 2014). Which of them the camera is at,
kinematics tell by where they have the target's plane; else the image, where it shows the
difference.
"""

from __future__ import annotations

from collections.abc import Iterator
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

# Normalised distance of points up to which features may count them as at their goals, and part of
# the target's radius.
MAX_POINT_DISTANCE, MAX_RADIUS_PART = 5e-3, 0.1
# Parts of the depth and rad: a pose that is no farther from another one is the same, and a plane
# that is no other is the target's own, turned about its normal, as a symmetric target may be.
SAME_POSE, SAME_PLANE = 2e-3, 0.02
# times as near a pose has to be as another one, to be the one that kinematics tell
NEARER_FACTOR = 0.5
# squared deviations by which an image has to fit one pose better than another
MIN_FIT_DIFFERENCE = 25.0
EXACT_ACCURACY = 1e-6  # normalised; accuracy of exact points
# part of the target's radius that points may be off an affine map of the goal's
AFFINE_TOLERANCE = 0.1


@dataclass(frozen=True, eq=False)
class AmbiguousPose:
    """A pose from which the goal's points look alike.

    Attributes:
        points: (n, 2) what is seen there of each of the goal's points, in the goal's order.
        inverse_depth: (n,) of them, 1/m.
        plane: (3,) of the target there, as Plane.
        distance, angle: from the goal, m and rad.
    """

    points: np.ndarray
    inverse_depth: np.ndarray
    plane: np.ndarray
    distance: float
    angle: float


class AmbiguousPoses:
    """The other poses of one goal, worked out once."""

    def __init__(self, goal: Goal) -> None:
        self.goal = goal
        self._points, self.poses = np.zeros((0, 2)), ()
        taught = [np.array(one["points"], float) for one in goal.features.values()
                  if "points" in one]  # fmt: skip
        if goal.other_cameras or not taught or taught[0].ndim != 2 or len(taught[0]) < 3:
            return
        self._plane = np.array(goal.plane or Plane.fronto_parallel(goal.distance))
        self._points = points = taught[0]
        self._inverse_depth = np.column_stack([points, np.ones(len(points))]) @ self._plane
        if (self._inverse_depth > 0.0).all() and not are_collinear(points):
            self.poses = tuple(self._find_poses())

    def find_pose(
        self, observation: Observation
    ) -> tuple[AmbiguousPose | None, tuple[AmbiguousPose, ...]]:
        """Which of the poses the camera is at, None where it is at none; and at which it may be."""
        open_, nearest, least = [], None, np.inf
        for pose in self.poses:
            here, there = 1.0, 1.0
            if observation.plane is not None:
                plane = np.array(observation.plane)
                here, there = (
                    _compare_planes(plane, self._plane),
                    _compare_planes(plane, pose.plane),
                )
            if here < NEARER_FACTOR * there:
                continue
            if there >= NEARER_FACTOR * here:
                better = self._compare_fit(observation, pose)
                if better < -MIN_FIT_DIFFERENCE:
                    continue
                if better <= MIN_FIT_DIFFERENCE:
                    open_.append(pose)
                    continue
            if there < least:
                nearest, least = pose, there
        return nearest, tuple(open_)

    def _compare_fit(self, observation: Observation, pose: AmbiguousPose) -> float:
        """By how many squared deviations the image fits the pose better than the goal."""
        seen = _match_corners(observation.corners, self._points)
        if seen is None:
            return 0.0
        accuracy = max(observation.with_noise().corner_accuracy, EXACT_ACCURACY)
        at_goal = _compute_unexplained(seen, self._points, self._inverse_depth)
        at_pose = _compute_unexplained(seen, pose.points, pose.inverse_depth)
        return (at_goal - at_pose) / accuracy**2

    def _find_poses(self) -> Iterator[AmbiguousPose]:
        """The poses, each once."""
        points, known = self._points, [np.eye(4)]
        there = backproject(points, self._inverse_depth)
        radius = float(np.sqrt(points.var(axis=0).sum()))
        close = min(MAX_POINT_DISTANCE, MAX_RADIUS_PART * radius)
        for shift in range(len(points)):
            seen = np.roll(points, -shift, axis=0)
            if not _is_affine(points, seen, AFFINE_TOLERANCE * radius):
                continue
            for c_T_g in _solve_poses(there, seen):
                X = there @ c_T_g[:3, :3].T + c_T_g[:3, 3]
                if not (X[:, 2] > 0.0).all():
                    continue
                found = X[:, :2] / X[:, 2:]
                if np.abs(found - seen).max() > close:
                    continue
                if any(_is_same_pose(c_T_g, one, self.goal.distance) for one in known):
                    continue
                known.append(c_T_g)
                normal = c_T_g[:3, :3] @ self._plane
                plane = normal / (1.0 + normal @ c_T_g[:3, 3])
                if _compare_planes(plane, self._plane) > SAME_PLANE:
                    distance, angle = pose_difference(np.eye(4), inverse(c_T_g))
                    back = np.roll(np.arange(len(points)), shift)
                    yield AmbiguousPose(found[back], (1.0 / X[:, 2])[back], plane, distance, angle)


def _solve_poses(places: np.ndarray, points: np.ndarray) -> Iterator[np.ndarray]:
    """c_T_g (4, 4) from which places (n, 3) of a plane in g are seen at points (n, 2), nearly."""
    centre = places.mean(axis=0)
    about = np.ascontiguousarray(places - centre)[:, None]
    image, size = np.ascontiguousarray(points)[:, None], float(np.abs(about).max())
    if len(points) == 3:
        _, turns, ways = cv2.solveP3P(about / size, image, np.eye(3), None, cv2.SOLVEPNP_P3P)
    else:
        _, turns, ways, _ = cv2.solvePnPGeneric(
            about / size, image, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
        )
    for turn, way in zip(turns, ways, strict=True):
        R = cv2.Rodrigues(turn)[0]
        try:
            yield refine_pose(R, size * np.ravel(way) - R @ centre, places, points)
        except (MeasurementError, np.linalg.LinAlgError):
            continue


def _compare_planes(one: np.ndarray, other: np.ndarray) -> float:
    """Between two planes (3,) in the camera's frame: angle, rad, and part of the distance."""
    sizes = np.linalg.norm(one), np.linalg.norm(other)
    cosine = float(np.clip(one @ other / (sizes[0] * sizes[1]), -1.0, 1.0))
    return float(np.arccos(cosine) + abs(np.log(sizes[0] / sizes[1])))


def _is_same_pose(one: np.ndarray, other: np.ndarray, depth: float) -> bool:
    """Whether two poses (4, 4) are the same."""
    distance, angle = pose_difference(one, other)
    return distance / depth + angle < SAME_POSE


def _is_affine(points: np.ndarray, mapped_points: np.ndarray, tolerance: float) -> bool:
    """Whether points (n, 2) are seen elsewhere by an affine map, to within a distance."""
    flat = np.column_stack([points, np.ones(len(points))])
    rest = mapped_points - flat @ np.linalg.lstsq(flat, mapped_points, rcond=None)[0]
    return bool(np.abs(rest).max() <= tolerance)


def _match_corners(corners: np.ndarray | None, points: np.ndarray) -> np.ndarray | None:
    """Corners (n, 2) in the order of those points (n, 2) that they lie next to; None where they
    are others."""
    if corners is None or len(corners) < len(points):
        return None
    away = np.linalg.norm(np.asarray(corners)[None] - points[:, None], axis=2)
    nearest = away.argmin(axis=1)
    if (
        len(set(nearest.tolist())) < len(points)
        or away.min(axis=1).max() > 2.0 * MAX_POINT_DISTANCE
    ):
        return None
    return np.asarray(corners)[nearest]


def _compute_unexplained(
    image_points: np.ndarray, points: np.ndarray, inverse_depth: np.ndarray
) -> float:
    """Square of what no motion of the camera explains of where points (n, 2) are seen."""
    L, off = point_interaction(points, inverse_depth), (image_points - points).ravel()
    rest = off - L @ np.linalg.lstsq(L, off, rcond=None)[0]
    return float(rest @ rest)
