"""Upper bound of the distance between an arrived camera and its goal, exceeded in 0.3 % of runs.

The bound is a sum of

- the mean offset of the camera, which follows from the error and L, and the noise of this mean;
- twice the accuracy of the features, once for the image and once for the goal;
- the offset along camera directions that the features do not control but kinematics hold constant;
- the motion along directions that neither features nor kinematics measure;
- the distance of other camera poses from which the target looks the same.

Offsets are scaled in this module: rotations are multiplied by the target's depth, so that all six
components are in m.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import inf, pi, radians, sin
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.poses import pose_difference
from aras_visual_servo_camera.interaction import Plane

from ..goals.goal import DEFAULT_DEPTH, Goal
from ..kinematics.held_directions import compute_held_directions
from ..records.outcomes import NO_REMEDY, PoseUncertainty
from ..records.remedy import Remedy
from .advice import suggest_larger_target
from .camera_offset import RANK_TOLERANCE, PoseOffsets
from .offset_statistics import (
    Z_997,
    compute_bounds,
    compute_unexplained_ratio,
    estimate_residual_accuracy,
)

if TYPE_CHECKING:
    from ..kinematics.ik_solution import IKSolution
    from ..observation.observation import Observation
    from ..schemes.base import SchemeOutput
    from .ambiguous_poses import AmbiguousPose
    from .goal_plane import GoalPlane

# If the uncertainty of the camera's pose is below this, 'converged' is reported without the
# uncertainty. Translation as a fraction of the target's depth (0.3 mm at 0.2 m), rotation in rad.
NEGLIGIBLE_UNCERTAINTY = (1.5e-3, radians(0.3))
# A camera is at rest if, according to the joints, it moves less than this between two images:
# translation as a fraction of the target's depth, rotation in rad.
REST_MOTION = (5e-5, 1e-4)
# After an image, the camera keeps its speed for at most this time, s, because the next command
# takes effect gradually.
REACTION_TIME = 0.06
# Factor on the standard deviation of corners and pixels, because large errors are more frequent
# than in a normal distribution. Measured on 949 pairs of rendered views: with this factor, 0.8 % of
# the offsets that are measured with corners exceed the 99.7 % bound, at most by a factor of 1.2.
TAIL_FACTOR = 1.1
# Part of the standard deviation of one image that averaging over images does not remove. It is due
# to the clipping of noise at black and white. Measured with corners and markers over 25 images with
# a noise of 5 grey levels: the error of the mean is at least 0.4 standard deviations in a quarter
# of the cases. Independent noise would give 0.2.
SYSTEMATIC_PART = 0.25
# Largest offset of the camera for which the linearisation by L is valid: translation as a fraction
# of the depth, rotation in rad. A direction of camera motion with a larger uncertainty is treated
# as not measured.
MAX_LINEAR_OFFSET = 0.05
# Largest standard deviation of the camera's offset in a single image, in m per m of depth and rad.
# The limit is larger than MAX_LINEAR_OFFSET, because several images are averaged.
MAX_SCATTER = 0.08
# An unmeasured direction of camera motion is treated as a pure translation if its translation
# exceeds its rotation times the target's depth by this factor; otherwise as a rotation about an
# axis.
MIN_TRANSLATION_RATIO = 20.0
# The part of the error that no camera motion explains is evaluated only if L has at most this many
# rows. Features with more components declare their accuracy.
MAX_RESIDUAL_ROWS = 64
# A direction of camera motion is measured poorly if its singular value of L is below this fraction
# of the largest one.
WEAK_DIRECTION = 0.05
NO_OFFSET, IDENTITY = np.zeros(6), np.eye(6)
USE_LARGER_TARGET = suggest_larger_target(1.5)
ADD_FEATURE = Remedy("if the exact pose matters, add a feature that measures these motions")
PLANE_REASON = (
    "according to kinematics, the target's plane in the camera frame is not that of the goal (the "
    "target was moved, the calibration is wrong, or another pose has the same features):"
)
CHECK_CALIBRATION = Remedy("check the camera's calibration and the target's pose at the goal")
ADD_POINTS = Remedy("use a target with more points, farther apart, or not in one plane")


class ArrivalMargin:
    """Model of the uncertainty of an arrival, created when the camera reaches its goal.

    A new model is created when the error has decreased further; see `arrival_check.RENEWAL_RATIO`.
    """

    def __init__(
        self,
        scheme_output: SchemeOutput,
        goal_plane: GoalPlane,
        free: np.ndarray,
        error: np.ndarray,
        accuracy: np.ndarray | float | None,
        noise: np.ndarray,
        scatter: np.ndarray,
    ) -> None:
        """Create the model from the image with which the camera reached its goal.

        Args:
            scheme_output: measurement and task of the image.
            goal_plane: goal of the run with the target's plane.
            free: (f, 6) camera directions that the task controls, see `split_directions`.
            error: (k,) mean error of the last images.
            accuracy: accuracy of the features that are the rows of L, see `Feature.accuracy`.
            noise: (k,) standard deviation of each component of the mean error.
            scatter: (6, 6) covariance of the offset of a single image, m and rad.
        """
        goal, self._goal_plane = goal_plane.goal, goal_plane
        self._ambiguity = scheme_output.ambiguity
        self._symmetry_bound = bound_symmetry(scheme_output.ambiguity, goal)
        self._systematic_part = 0.0 if accuracy is None else SYSTEMATIC_PART
        self._depth = depth = goal.distance
        scale = self._scale = np.array([1.0] * 3 + [depth] * 3)
        L = np.asarray(scheme_output.L, float) / scale
        if scheme_output.residual is not None:
            error, noise = scheme_output.residual, 0.0
        if np.ndim(accuracy) == 0 and accuracy is not None:
            accuracy = accuracy * np.eye(len(L))
        if len(error) <= MAX_RESIDUAL_ROWS:
            accuracy = estimate_residual_accuracy(L, error, noise) if accuracy is None else (
                accuracy * max(compute_unexplained_ratio(L, error, accuracy, noise), 1.0)
            )  # fmt: skip
        # With more than six rows, replace L by six rows that give the same least-squares solution.
        if len(L) > 6:
            Q, L = np.linalg.qr(L)
            accuracy = None if accuracy is None else Q.T @ accuracy
        u, s, vt = np.linalg.svd(L @ free.T)
        if len(s) < len(vt):
            s = np.append(s, np.zeros(len(vt) - len(s)))
        is_measured = s > RANK_TOLERANCE * s[0]
        if accuracy is not None:
            spread = (u.T @ accuracy)[: len(s)]
            spread = np.vstack([spread, np.zeros((len(s) - len(spread), spread.shape[1]))])
            is_measured &= np.linalg.norm(spread, axis=1) <= MAX_LINEAR_OFFSET / Z_997 * depth * s
        along = vt @ free
        variance = ((along * scale) @ scatter * (along * scale)).sum(axis=1)
        is_measured &= np.sqrt(np.maximum(variance, 0.0)) <= MAX_SCATTER * depth
        inverse = np.divide(1.0, s, out=np.zeros_like(s), where=is_measured)
        # `out` (6, f) maps U^T e to an offset of the camera, where L = U S V^T.
        out = free.T @ vt.T * inverse
        self._measurement_covariance = np.zeros((6, 6))
        if accuracy is not None:
            spread = out @ spread
            # The factor 2 accounts for the goal, which was measured with the same accuracy.
            self._measurement_covariance = 2.0 * TAIL_FACTOR**2 * spread @ spread.T
        rows = min(len(L), len(s))
        self._coupling = np.eye(6) - out[:, :rows] @ u.T[:rows] @ L
        self._unseen_directions = along[~is_measured]
        self._poor_directions = along[is_measured & (s < WEAK_DIRECTION * s[0])]
        self._plane_offset: tuple[float, float] | None = None

    @property
    def has_unseen_directions(self) -> bool:
        """Return whether there is a camera direction that neither features nor kinematics measure.
        """
        return len(self._unseen_directions) > 0

    def bound_uncertainty(
        self,
        observation: Observation,
        held_offset: np.ndarray,
        offsets: PoseOffsets,
        unseen_motion: np.ndarray,
        poses: Sequence[AmbiguousPose],
    ) -> PoseUncertainty:
        """Bound the distance of the camera from its goal at one image.

        Args:
            observation: observation of the image.
            held_offset: (6,) offset along the held directions, see `split_directions`.
            offsets: mean offset and its covariance.
            unseen_motion: (6,) camera motion that the image shows but no feature measures, in m
                (rotations times the target's depth).
            poses: ambiguous poses at which the camera may be.

        Returns:
            The bounds of translation and rotation, with their cause and a remedy as text.
        """
        scatter_part = self._compute_scatter_part(offsets)
        distance, angle = compute_bounds(
            offsets.mean, offsets.scatter, self._measurement_covariance, scatter_part,
            self._coupling, held_offset, self._scale,
        )  # fmt: skip
        distance += REST_MOTION[0] * self._depth + REACTION_TIME * offsets.speed[0]
        angle = angle / self._depth + REST_MOTION[1] + REACTION_TIME * offsets.speed[1]
        parts = [self._ambiguity] if self._ambiguity else []
        reason, remedy = "", NO_REMEDY
        if count := len(self._unseen_directions):
            parts.append(f"{count} direction{'s' if count > 1 else ''}")
            reason = f"no feature measures {count} of the camera's directions accurately enough"
            remedy = ADD_FEATURE
        else:
            cause, remedy = "because of noise and limited image accuracy", USE_LARGER_TARGET
            # The offset due to the plane is computed once, because the camera is at rest after its
            # arrival.
            if self._plane_offset is None:
                self._plane_offset = self._goal_plane.compute_offset(
                    observation.world_T_camera,
                    self.compute_offset(held_offset, offsets.mean), self._poor_directions,
                )  # fmt: skip
            plane_distance, plane_angle = self._plane_offset
            if plane_distance > distance or plane_angle > angle:
                plane_distance, plane_angle = pose_difference(
                    self._goal_plane.goal.world_T_camera, observation.world_T_camera
                )
                distance, angle = distance + plane_distance, min(angle + plane_angle, pi)
                cause, remedy = PLANE_REASON, CHECK_CALIBRATION
            if unseen_motion.any():
                distance += float(np.linalg.norm(unseen_motion[:3]))
                angle += float(np.linalg.norm(unseen_motion[3:])) / self._depth
                cause = "because the view differs by a motion that no feature measures"
                remedy = ADD_FEATURE
            if poses:
                distance += max(pose.distance for pose in poses)
                angle = min(angle + max(pose.angle for pose in poses), pi)
                cause = f"because {len(poses) + 1} camera poses give the same image points"
                remedy = ADD_POINTS
            if size := _format_size(distance, angle, self._depth):
                parts.append(size)
                reason = (
                    f"{cause} the camera may be {1e3 * distance:.2f} mm and "
                    f"{np.degrees(angle):.2f} degrees from its goal"
                )
            remedy = remedy if reason else NO_REMEDY
        if parts:
            for extra_distance, extra_angle in (self._bound_unseen_motion(), self._symmetry_bound):
                distance, angle = distance + extra_distance, min(angle + extra_angle, pi)
        return PoseUncertainty(distance, angle, " and ".join(parts), reason, remedy)

    def compute_offset(self, held_offset: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """Combine an offset measured by the features with the offset that kinematics give.

        Args:
            held_offset: (6,) offset along the held directions, see `split_directions`.
            offset: (6,) offset of the camera from the goal by features, m and rad.

        Returns:
            The combined offset (6,), in m (rotations times the target's depth).
        """
        return offset * self._scale + self._coupling @ held_offset

    def compute_covariance(self, offsets: PoseOffsets) -> np.ndarray:
        """Return the covariance (6, 6) of the mean offset, in m^2 (rotations times the depth).

        It is the sum of the scatter that remains in the mean and of the accuracy of the features.
        """
        scatter = self._scale[:, None] * offsets.scatter * self._scale
        return self._compute_scatter_part(offsets) * scatter + self._measurement_covariance

    def _compute_scatter_part(self, offsets: PoseOffsets) -> float:
        """Return the ratio of the variance of the mean offset to that of one image's offset."""
        return 1.0 / max(offsets.count - 1, 1) + self._systematic_part**2

    def _bound_unseen_motion(self) -> tuple[float, float]:
        """Return bounds of the camera's motion along unmeasured directions, m and rad."""
        if not len(self._unseen_directions):
            return 0.0, 0.0
        distance, angle = (
            float(np.linalg.norm(part)) for part in np.split(self._unseen_directions[0], 2)
        )
        if len(self._unseen_directions) > 1 or distance > MIN_TRANSLATION_RATIO * angle:
            return inf, pi
        # the unmeasured motion is a rotation, by up to pi, about an axis beside the camera
        return 2.0 * distance * self._depth / angle, pi


def split_directions(
    observation: Observation, goal: Goal, modelled: np.ndarray, ik_solution: IKSolution | None
) -> tuple[np.ndarray, np.ndarray]:
    """Split the camera directions into those that the task controls and those held by kinematics.

    For an arm with fewer than six joints, the directions of the task are all those in which the arm
    can move the camera.

    Args:
        observation: observation with the camera's pose.
        goal: goal of the run.
        modelled: (6,) whether the task controls each component of the camera's twist.
        ik_solution: joint velocities with the arm's Jacobian; None for a free camera.

    Returns:
        The offset (6,) along the held directions, and the directions (f, 6) of the task. Rotations
        are multiplied by the target's depth.
    """
    if ik_solution is not None and ik_solution.jacobian.shape[1] < 6:
        scale = np.repeat((1.0, goal.distance), 3)
        return np.zeros(6), np.linalg.qr(scale[:, None] * ik_solution.jacobian)[0].T
    here, there = observation.world_T_camera, goal.world_T_camera
    if all(modelled.tolist()):
        return NO_OFFSET, IDENTITY
    if here is None or there is None:
        return NO_OFFSET, IDENTITY[modelled]
    held, errors, free = compute_held_directions(here, there, modelled, goal.distance)
    return -errors @ held, free


def bound_symmetry(ambiguity: str, goal: Goal) -> tuple[float, float]:
    """Bound how far the camera may be from its goal because the target looks the same when rotated.

    Args:
        ambiguity: angle of the symmetry, such as '90°'; any other text gives infinite bounds.
        goal: goal of the run.

    Returns:
        Distance, m, and angle, rad.
    """
    if not ambiguity:
        return 0.0, 0.0
    found = re.match(r"(\d+)°", ambiguity)
    if found is None:
        return inf, pi
    step = radians(float(found[1]))
    angle = step * max(round(pi / step - 0.01), 1)
    angle = min(angle, 2.0 * pi - angle)
    plane = goal.plane or Plane.fronto_parallel(goal.distance)
    x, y = _get_centre(goal)
    centre = np.array([x, y, 1.0]) / plane.inverse_depth(x, y)
    normal = np.array(plane) / np.linalg.norm(plane)
    axis_distance = float(np.linalg.norm(np.cross(centre, normal)))
    return 2.0 * axis_distance * sin(0.5 * angle), angle


def _get_centre(goal: Goal) -> np.ndarray:
    """Return the target's centre (2,) at the goal, normalised; (0, 0) if it is unknown."""
    if goal.moments is not None:
        return np.array([goal.moments.xg, goal.moments.yg])
    for feature in goal.features.values():
        if "points" in feature:
            return np.mean(feature["points"], axis=0)
    return np.zeros(2)


def _format_size(distance: float, angle: float, depth: float = DEFAULT_DEPTH) -> str:
    """Format a distance (m) or an angle (rad), such as '0.4 mm' or '0.5 degrees'.

    The text contains the one that is larger relative to its NEGLIGIBLE_UNCERTAINTY. It is empty if
    both are negligible.
    """
    parts = distance / (NEGLIGIBLE_UNCERTAINTY[0] * depth), angle / NEGLIGIBLE_UNCERTAINTY[1]
    if max(parts) <= 1.0:
        return ""
    if parts[0] >= parts[1]:
        return f"{np.ceil(1e4 * distance) / 10.0:g} mm"
    return f"{np.ceil(10.0 * np.degrees(angle)) / 10.0:g} degrees"
