"""Check whether the camera has arrived at its goal, and bound its remaining distance."""

from __future__ import annotations

from math import nan
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.compiled import jit

from ..records.outcomes import NOT_ARRIVED, ArrivalStatus, PoseUncertainty
from .camera_offset import (
    FEW_IMAGES,
    HYSTERESIS,
    MAX_WINDOW,
    PoseOffsets,
    compute_mean_offset,
    compute_observable,
    compute_offset,
)
from .goal_plane import GoalPlane
from .pose_uncertainty import ArrivalMargin, bound_symmetry, split_directions
from .vector_history import VectorHistory
from .view_check import MIN_VIEWS, ViewCheck

if TYPE_CHECKING:
    from ..goals.goal import Goal
    from ..kinematics.ik_solution import IKSolution
    from ..observation.observation import Observation
    from ..schemes.base import JointController, Scheme, SchemeOutput
    from .ambiguous_poses import AmbiguousPoses

# Largest rms deviation of the errors from their mean, in units of the tolerance. A larger deviation
# is due to motion, not to noise.
MAX_SCATTER = 3.0
MIN_IMAGES = 3  # smallest number of images that can show an arrival
# If an error exceeds this number of tolerances (four times MAX_SCATTER), the stored offsets of the
# camera are removed. So far from the goal, the linearisation by L is not valid.
FAR_TOLERANCES = 12.0
# The uncertainty of the pose is computed again each time the mean error has decreased by this
# factor. It is not computed again once the mean error is below NEGLIGIBLE_ERROR, in units of the
# tolerance.
RENEWAL_RATIO = 0.7
NEGLIGIBLE_ERROR = 0.1
# After an arrival, the first VIEW_PERIOD images are compared with the goal, then only every
# VIEW_PERIOD-th image.
VIEW_PERIOD = 8
ALIKE_REASON = "several camera poses give the same image points as the goal"
OTHER_VIEW_REASON = "every feature is at its goal, but the image differs from the goal's"
TIME_ROUNDING = 1e-9  # numerical tolerance of times, s


class ArrivalCheck:
    """Test of whether the mean error over `hold` seconds shows that the camera has arrived.

    Once the camera has arrived, the tolerances are multiplied by HYSTERESIS.
    """

    def __init__(self, goal: Goal, scheme: Scheme | JointController, hold: float) -> None:
        """Create the check.

        Args:
            goal: goal of the run.
            scheme: scheme of the run; it gives the tolerances and the accuracy of the errors.
            hold: averaging time, s; 0 evaluates each image separately.
        """
        self._goal, self._scheme, self._hold = goal, scheme, float(hold)
        self._errors, self._offsets = VectorHistory(), VectorHistory(max_count=MAX_WINDOW)
        self._view_check = ViewCheck(goal)
        # Both are created at the first arrival, because most images are not at the goal.
        self._ambiguous_poses: AmbiguousPoses | None = None
        self._goal_plane: GoalPlane | None = None
        self.clear()

    def clear(self) -> None:
        """Remove all images, because the loop was interrupted."""
        self._errors.clear()
        self._offsets.clear()
        self._view_check.clear()
        self._is_reached = False
        self._margin: ArrivalMargin | None = None
        # Ambiguous pose at which the camera is (None if it is at none), and all ambiguous poses
        # that cannot be ruled out.
        self._other_pose, self._possible_poses = None, ()
        self._wrong_pose_reason, self._unseen_motion, self._images = "", np.zeros(6), 0
        # Mean error, in units of the tolerance, when `_margin` was last computed.
        self._error_size = 0.0

    def add(
        self, scheme_output: SchemeOutput, observation: Observation,
        ik_solution: IKSolution | None = None,
    ) -> ArrivalStatus:  # fmt: skip
        """Add one image and return the arrival status.

        Args:
            scheme_output: measurement and task of the image.
            observation: observation of the image.
            ik_solution: joint velocities for the task; they show in which directions the arm can
                move the camera. None for a free camera.
        """
        goal, errors, ambiguity = self._goal, self._errors, scheme_output.ambiguity
        if errors.rows.shape[1] != scheme_output.error.size:
            self.clear()
        errors.add(observation.stamp, scheme_output.error)
        is_far, old_count, settled = _evaluate_errors(
            errors.stamps, errors.rows, np.asarray(self._scheme.tolerances, float), self._hold,
            HYSTERESIS if self._is_reached else 1.0,
        )  # fmt: skip
        if old_count:
            errors.drop_oldest(old_count)
        directions, row = None, None
        if not is_far and scheme_output.task is not None:
            directions = split_directions(
                observation, goal, scheme_output.task.modelled, ik_solution
            )
            row = compute_offset(
                scheme_output, directions[1], goal.distance, observation.world_T_camera
            )
        # The stored offsets of the camera are removed if L does not determine the present one.
        if row is not None:
            self._offsets.add(observation.stamp, row)
        elif self._offsets.rows.size:
            self._offsets.clear()
        offsets, reason = None, ""
        if settled and row is not None:
            observable = compute_observable(scheme_output, directions[1], goal.distance)
            offsets, reason = compute_mean_offset(
                self._offsets.stamps, self._offsets.rows, observable, len(errors.rows),
                self._is_reached, goal.distance,
            )  # fmt: skip
        self._view_check.add(observation)
        if not settled or reason:
            if self._is_reached:
                self._view_check.clear()
            self._is_reached, self._margin = False, None
            return ArrivalStatus(pending_reason=reason) if reason else NOT_ARRIVED
        # The camera has just arrived: ignore the images that precede the arrival.
        if not self._is_reached:
            self._images = 0
            self._view_check.retain(max(1 if offsets is None else offsets.count, MIN_VIEWS))
        self._is_reached = True
        if offsets is None:
            bounds = bound_symmetry(ambiguity, goal) if ambiguity else (nan, nan)
            return ArrivalStatus(True, pose_uncertainty=PoseUncertainty(*bounds, ambiguity))
        return self._evaluate_arrival(scheme_output, observation, directions, offsets)

    def _evaluate_arrival(
        self, scheme_output: SchemeOutput, observation: Observation,
        directions: tuple[np.ndarray, np.ndarray], offsets: PoseOffsets,
    ) -> ArrivalStatus:  # fmt: skip
        """Return the arrival status, with the remaining uncertainty, of a camera at its goal."""
        held_offset, free = directions
        self._images += 1
        # The margin is computed again after the error has decreased, because the features become
        # more accurate near the goal.
        if self._margin is None or self._error_size > NEGLIGIBLE_ERROR:
            mean_error = self._errors.rows.mean(axis=0)
            size = float(np.linalg.norm(mean_error / np.asarray(self._scheme.tolerances, float)))
            if self._margin is None or size < RENEWAL_RATIO * self._error_size:
                self._error_size = size
                self._renew_margin(scheme_output, observation, free, offsets)
        if self._images <= VIEW_PERIOD or self._images % VIEW_PERIOD == 0:
            mean_offset = self._offsets.rows[-len(self._view_check) :, :6].mean(axis=0)
            self._compare_views(
                self._margin.compute_offset(held_offset, mean_offset), scheme_output.ambiguity
            )
        uncertainty = self._margin.bound_uncertainty(
            observation, held_offset, offsets, self._unseen_motion, self._possible_poses
        )
        return ArrivalStatus(True, "", self._wrong_pose_reason, uncertainty)

    def _renew_margin(
        self, scheme_output: SchemeOutput, observation: Observation, free: np.ndarray,
        offsets: PoseOffsets,
    ) -> None:  # fmt: skip
        """Model the uncertainty of the arrival at this image, and find other possible poses."""
        # The accuracy is estimated from the same images as the offset, so that both belong to the
        # same distance from the goal.
        goal, latest = self._goal, self._errors.rows[-max(offsets.count, MIN_VIEWS) :]
        if self._ambiguous_poses is None:
            from .ambiguous_poses import AmbiguousPoses

            self._ambiguous_poses = AmbiguousPoses(goal)
        if self._goal_plane is None or self._goal_plane.camera is not observation.camera:
            self._goal_plane = GoalPlane(goal, observation.camera)
        self._margin = ArrivalMargin(
            scheme_output, self._goal_plane, free, latest.mean(axis=0),
            self._scheme.accuracy(observation, goal),
            latest.std(axis=0) / np.sqrt(len(latest)), offsets.scatter,
        )  # fmt: skip
        self._other_pose, self._possible_poses = self._ambiguous_poses.find_pose(observation)
        # If the scheme has a residual (error of a whole image), L describes the residual and not
        # the features.
        if scheme_output.residual is None:
            L = scheme_output.L / np.asarray(self._scheme.tolerances, float)[:, None]
            self._view_check.set_expected_place(
                observation, L / np.repeat((1.0, goal.distance), 3),
                self._margin.compute_covariance(offsets),
            )  # fmt: skip

    def _compare_views(self, offset: np.ndarray, ambiguity: str) -> None:
        """Compare the images since the arrival with the goal, and store the results.

        The results are the reason why the camera is at another pose than the goal (empty if it is
        not), and the camera motion that the images show although no feature measures it.

        Args:
            offset: (6,) offset of the camera from the goal by features and kinematics, m (rotations
                are multiplied by the target's depth).
            ambiguity: rotational symmetry of the target, as text.
        """
        place, self._unseen_motion = self._view_check.compare_place(offset)
        self._wrong_pose_reason = ""
        if self._other_pose is not None:
            self._wrong_pose_reason = (
                f"{ALIKE_REASON}: the camera is at one of them, "
                f"{1e3 * self._other_pose.distance:.1f} mm and "
                f"{np.degrees(self._other_pose.angle):.1f} degrees from its goal"
            )
        elif place:
            self._wrong_pose_reason = f"{OTHER_VIEW_REASON}: {place}"
        elif not self._margin.has_unseen_directions and self._view_check.has_other_shape(
            bool(ambiguity)
        ):
            self._wrong_pose_reason = f"{OTHER_VIEW_REASON}: the target's outline has another shape"


@jit("f8[:], f8[:,:], f8[:], f8, f8", allocates=False)
def _evaluate_errors(stamps, errors, tolerances, hold, factor):
    """Evaluate the errors of m images: are they far off, and have the features settled?

    The features have settled if the mean error of the last `hold` seconds is within the tolerances,
    with little scatter: the rms deviation of the errors from their mean must be below MAX_SCATTER
    times the tolerances.

    Args:
        stamps: (m,) stamps of the images, s.
        errors: (m, k) errors of the images.
        tolerances: (k,) tolerances of the errors.
        hold: averaging time, s.
        factor: factor on the tolerances.

    Returns:
        Whether a component of the last error exceeds FAR_TOLERANCES tolerances; the number of
        images that are too old to be averaged; whether the features have settled.
    """
    is_far, count, now = False, len(stamps), stamps[len(stamps) - 1]
    for k in range(len(tolerances)):
        is_far |= abs(errors[count - 1, k]) > FAR_TOLERANCES * tolerances[k]
    # One image older than `hold` seconds is retained. It shows that the images cover the whole
    # averaging time.
    min_count, first = MIN_IMAGES if hold > 0.0 else 1, 0
    while first < count - min_count and stamps[first + 1] <= now - hold + TIME_ROUNDING:
        first += 1
    count -= first
    if count < min_count or now - stamps[first] < hold - TIME_ROUNDING:
        return is_far, first, False
    for k in range(len(tolerances)):
        limit, mean, square = tolerances[k] * factor, 0.0, 0.0
        for i in range(first, len(stamps)):
            mean += errors[i, k]
            # The mean of a few images could hide a motion, so each of them has to be near.
            if count < FEW_IMAGES and not abs(errors[i, k]) < limit:
                return is_far, first, False
        mean /= count
        for i in range(first, len(stamps)):
            square += (errors[i, k] - mean) ** 2
        if not (abs(mean) < limit and square / count < (MAX_SCATTER * limit) ** 2):
            return is_far, first, False
    return is_far, first, True
