"""Keypoints of a texture, matched between the image and the goal image.

The target is only assumed to be flat; its geometry need not be known.
"""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np

from aras_visual_servo_camera.interaction import Plane, point_interaction

from ..errors import ConfigurationError, MeasurementError
from ..goals.goal import Goal
from ..observation.observation import Observation
from .base import FEATURES, FeatureMeasurement, get_plane
from .luminance import Luminance, get_grey_image
from .points import backproject as places_of
from .pose import PoseInGoalFrame, compute_goal_frame_feature, estimate_planar_pose

MATCH_RATIO = 0.8  # largest ratio of best to second-best match distance (Lowe 2004)
MIN_MATCHES = 8  # smallest number of matches that fit one homography
MAX_REPROJECTION_ERROR = 3.0  # largest distance of a match from the homography, px
# Offset of SIFT keypoints to the right and down, px, because SIFT first doubles the size of the
# image.
SIFT_OFFSET = 0.25
# Depths of matches are limited to this, in units of the goal's distance, because a wrong match may
# lie beyond the horizon of the plane.
MAX_DEPTH = 500.0


@FEATURES.register("matches")
class Matches(Luminance):
    """s = (x, y) of every keypoint that matches a keypoint of the goal image, normalised.

    Keypoints are detected by SIFT, or by ORB if `detector` is 'orb', in the image scaled down to at
    most `max_width` pixels. Matches that do not fit a common homography are rejected. The tolerance
    applies to the root mean square distance of the matches to the keypoints of the goal image.
    """

    names, tolerances, units = ("rms",), (0.001,), ("",)
    detector: ClassVar[str] = "sift"
    count: ClassVar[int] = 500
    max_width: ClassVar[int] = 320

    def __init__(self) -> None:
        super().__init__()
        if self.detector == "sift":
            self._detector, norm = cv2.SIFT_create(nfeatures=self.count), cv2.NORM_L2
        else:
            self._detector, norm = cv2.ORB_create(nfeatures=self.count), cv2.NORM_HAMMING
        self._matcher = cv2.BFMatcher(norm)

    def check(self, goal: Goal) -> None:
        """Refuse a goal that this feature cannot servo to."""
        super().check(goal)
        places, self._goal_descriptors = self.detect_keypoints(self._goal_image)
        if len(places) < MIN_MATCHES or goal.camera is None:
            raise ConfigurationError(
                f"the image of {goal.name} has {len(places)} keypoints, but {MIN_MATCHES} are "
                "needed: teach the goal with a textured target, or use the scheme moments"
            )
        self._goal_keypoints = places
        x, y, _ = goal.camera.normalise(*places.T)
        self._desired_points = np.column_stack([x, y])

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """Measure s, s*, the error and L in one image."""
        points, desired = self._match_keypoints(observation, goal)
        error = (points - desired).ravel()
        rms = float(np.sqrt(np.mean(error**2) * 2.0))
        A, B, C = get_plane(observation)
        w = np.maximum(A * points[:, 0] + B * points[:, 1] + C, 1.0 / (MAX_DEPTH * goal.distance))
        self._L = L = point_interaction(points, w)
        self._match_error = float(np.std(error - L @ np.linalg.lstsq(L, error, rcond=None)[0]))
        return FeatureMeasurement(
            points.ravel(), desired.ravel(), error, L,
            error_summary=np.array([rms]),
        )  # fmt: skip

    def accuracy(self, observation: Observation, goal: Goal) -> np.ndarray | float | None:
        """Return the accuracy of s: the rms error of the matches that no camera motion explains."""
        return self._match_error

    def detect_keypoints(self, grey: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Detect keypoints in a grey image (H, W).

        Return their positions (n, 2), px, and their descriptors (n, k). A subclass can override
        this method to use another detector.
        """
        scale = min(self.max_width / grey.shape[1], 1.0)
        if scale < 1.0:
            shape = self.max_width, max(round(grey.shape[0] * scale), 1)
            grey, scale = cv2.resize(grey, shape, interpolation=cv2.INTER_AREA), (
                shape[0] / grey.shape[1], shape[1] / grey.shape[0]
            )  # fmt: skip
        found, descriptors = self._detector.detectAndCompute(grey, None)
        places = np.array([k.pt for k in found], float).reshape(-1, 2)
        if self.detector == "sift":
            places -= SIFT_OFFSET
        return (places + 0.5) / scale - 0.5, descriptors

    def _match_keypoints(
        self, observation: Observation, goal: Goal
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return matched points (n, 2) of the image and of the goal, in normalised coordinates.

        Raises:
            MeasurementError: too few matches are consistent.
        """
        if self._goal is not goal:
            self.check(goal)
        places, descriptors = self.detect_keypoints(get_grey_image(observation))
        pairs = []
        if len(places) >= MIN_MATCHES:
            for two in self._matcher.knnMatch(descriptors, self._goal_descriptors, k=2):
                if len(two) == 2 and two[0].distance < MATCH_RATIO * two[1].distance:
                    pairs.append((two[0].queryIdx, two[0].trainIdx))
        if len(pairs) >= MIN_MATCHES:
            in_image, in_goal = np.array(pairs).T
            _, agree = cv2.findHomography(
                self._goal_keypoints[in_goal], places[in_image], cv2.RANSAC, MAX_REPROJECTION_ERROR
            )
            inliers = np.zeros(len(pairs), bool) if agree is None else agree.ravel().astype(bool)
            if inliers.sum() >= MIN_MATCHES:
                x, y, _ = observation.camera.normalise(*places[in_image[inliers]].T)
                return np.column_stack([x, y]), self._desired_points[in_goal[inliers]]
        raise MeasurementError(
            f"{len(pairs)} keypoints match the goal image, but {MIN_MATCHES} consistent matches "
            "are needed: bring the target into view, and use a textured target"
        )


@FEATURES.register("matches_orb")
class MatchesORB(Matches):
    """`matches` with ORB keypoints, which are ten times as fast as SIFT, but less reliable."""

    detector: ClassVar[str] = "orb"
    max_width: ClassVar[int] = 640


@FEATURES.register("matches_pose")
class MatchesPose(Matches):
    """Position-based servoing on matched keypoints of a plane: s = (g_t_c, theta u), as `pose`."""

    is_stackable = True
    names, tolerances, units = zip(*PoseInGoalFrame.components, strict=True)

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """Measure s, s*, the error and L in one image."""
        points, desired = self._match_keypoints(observation, goal)
        super().measure(observation, goal)
        plane = goal.plane or Plane.fronto_parallel(goal.depth)
        places = places_of(desired, desired @ (plane.A, plane.B) + plane.C)
        s, L = compute_goal_frame_feature(estimate_planar_pose(places, points))
        return FeatureMeasurement(s, np.zeros(6), s, L)

    def accuracy(self, observation: Observation, goal: Goal) -> np.ndarray | None:
        """Return the accuracy of s, which is propagated from that of the matches."""
        return np.linalg.pinv(self._L) * super().accuracy(observation, goal)
