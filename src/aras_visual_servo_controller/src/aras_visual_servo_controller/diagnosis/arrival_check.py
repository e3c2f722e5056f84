"""Check whether the camera has arrived at its goal, and bound its remaining distance.

Near the goal the error is e = s - s* = L x, where x (6,) is the camera's offset from the goal. The
noise is averaged over several images. As the camera moves between these images, the offset L^+ e of
each image is transformed to the present camera pose by kinematics. If the target moves with the
camera, the offsets scatter less without this transformation. In this case they are averaged without
it.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot, nan
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.compiled import jit

from ..goals.goal import DEFAULT_DEPTH
from ..kinematics.algebra import (
    is_task_finite,
    multiply,
    multiply_vector,
    solve_least_squares,
    svd,
)
from ..observation.vector_history import VectorHistory
from ..records.outcomes import ArrivalStatus, PoseUncertainty
from .pose_uncertainty import (
    RANK_TOLERANCE,
    ArrivalMargin,
    PoseOffsets,
    bound_symmetry,
    split_directions,
)
from .view_check import MIN_VIEWS, ViewCheck

if TYPE_CHECKING:
    from ..goals.goal import Goal
    from ..kinematics.ik_solution import IKSolution
    from ..observation.observation import Observation
    from ..schemes.base import JointController, Scheme, SchemeOutput
    from .ambiguous_poses import AmbiguousPoses

# Largest offset from the goal of a camera that has arrived: translation as a fraction of the
# target's depth, rotation in rad. The limit is needed in addition to the tolerances of the
# features, because some directions of camera motion hardly change the features. Times
# OFFSET_FACTORS, it is below NEGLIGIBLE_UNCERTAINTY.
GOAL_TOLERANCE = (8e-4, 3.5e-3)
# After its arrival, the camera may exceed the tolerances of the features and GOAL_TOLERANCE by this
# factor.
HYSTERESIS = 1.5
# The uncertainty of a mean offset is estimated as this number of its standard deviations.
KNOWN_DEVIATIONS = 2.0
# Largest rms deviation of the errors from their mean, in units of the tolerance. A larger deviation
# is due to motion, not to noise.
MAX_SCATTER = 3.0
# The mean of a few images could hide a motion. If fewer than FEW_IMAGES images are averaged, each
# single image therefore has to be within the tolerances.
FEW_IMAGES = 5
MIN_IMAGES = 3  # smallest number of images that can show an arrival
MAX_WINDOW = 120  # largest number of images over which the error is averaged
# If an error exceeds this number of tolerances (four times MAX_SCATTER), the stored offsets of the
# camera are removed. So far from the goal, the linearisation by L is not valid.
FAR_TOLERANCES = 12.0
# The uncertainty of the pose is computed again each time the mean error has decreased by this
# factor. It is not computed again once the mean error is below NEGLIGIBLE_ERROR, in units of the
# tolerance.
RENEWAL_RATIO = 0.7
NEGLIGIBLE_ERROR = 0.1
# Largest difference between the camera's offset in the latest image and the mean offset, in
# standard deviations. A larger difference shows that kinematics do not describe the camera's
# motion.
OUTLIER_DEVIATIONS = 5.0
NOISE_STEPS = 8  # minimum number of images from which the noise is estimated
# If L has more rows than this, least-squares problems with L are solved by the normal equations.
MAX_ROWS = 64
# After an arrival, the first VIEW_PERIOD images are compared with the goal, then only every
# VIEW_PERIOD-th image.
VIEW_PERIOD = 8
ALIKE_REASON = "several camera poses give the same image points as the goal"
OTHER_VIEW_REASON = "every feature is at its goal, but the image differs from the goal's"
NO_LIMIT = np.full(2, np.inf)
ROUNDING = 1e-9  # numerical tolerance of times (s), angles (rad) and lengths (m)


class ArrivalCheck:
    """Test of whether the mean error over `hold` seconds shows that the camera has arrived.

    Once the camera has arrived, the tolerances are multiplied by HYSTERESIS.
    """

    def __init__(self, hold: float) -> None:
        """Create the check.

        Args:
            hold: averaging time, s; 0 evaluates each image separately.
        """
        self.hold = float(hold)
        self._errors, self._offsets, self._view_check = (
            VectorHistory(),
            VectorHistory(),
            ViewCheck(),
        )
        self._ambiguous_poses: AmbiguousPoses | None = None
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
        self,
        scheme_output: SchemeOutput,
        observation: Observation,
        goal: Goal,
        scheme: Scheme | JointController,
        ik_solution: IKSolution | None = None,
    ) -> ArrivalStatus:
        """Add one image and return the arrival status.

        Args:
            scheme_output: measurement and task of the image.
            ik_solution: joint velocities for the task; they show in which directions the arm can
                move the camera. None for a free camera.
        """
        error, tolerances = scheme_output.error, np.asarray(scheme.tolerances, float)
        if len(self._errors) and self._errors.width != len(error):
            self.clear()
        self._errors.add(observation.stamp, error)
        settled, reason = self._has_settled(observation.stamp, tolerances), ""
        free = None
        if _is_far(error, tolerances):
            self._offsets.clear()
        else:
            if scheme_output.task is not None:
                free = split_directions(
                    observation, goal, scheme_output.task.modelled, ik_solution
                )[1]
            self._add_offset(scheme_output, observation, free, goal.distance)
        offsets = None
        if settled and len(self._offsets):
            offsets, reason = compute_mean_offset(
                self._offsets.stamps,
                self._offsets.errors,
                _compute_observable(scheme_output, free, goal.distance),
                len(self._errors),
                self._is_reached,
                goal.distance,
            )
        self._view_check.add(observation, goal)
        if not settled or reason:
            if self._is_reached:
                self._view_check.clear()
            self._is_reached, self._margin = False, None
            return ArrivalStatus(pending_reason=reason)
        # The camera has just arrived: ignore the images that precede the arrival.
        if not self._is_reached:
            self._images = 0
            self._view_check.retain(max(1 if offsets is None else offsets.count, MIN_VIEWS))
        self._is_reached = True
        if offsets is None:
            distance, angle = (
                bound_symmetry(scheme_output.ambiguity, goal)
                if scheme_output.ambiguity
                else (nan, nan)
            )
            return ArrivalStatus(
                True, pose_uncertainty=PoseUncertainty(distance, angle, scheme_output.ambiguity)
            )
        return self._evaluate_arrival(
            scheme_output, observation, goal, scheme, ik_solution, offsets
        )

    def _evaluate_arrival(
        self,
        scheme_output: SchemeOutput,
        observation: Observation,
        goal: Goal,
        scheme: Scheme | JointController,
        ik_solution: IKSolution | None,
        offsets: PoseOffsets,
    ) -> ArrivalStatus:
        """Return the arrival status, with the remaining uncertainty, of a camera at its goal."""
        tolerances = np.asarray(scheme.tolerances, float)
        errors = self._errors.errors
        size = float(np.linalg.norm(errors.mean(axis=0) / tolerances))
        self._images += 1
        # The margin is computed again after the error has decreased, because the features become
        # more accurate near the goal.
        if self._margin is None or (
            self._error_size > NEGLIGIBLE_ERROR and size < RENEWAL_RATIO * self._error_size
        ):
            self._error_size = size
            # The accuracy is estimated from the same images as the offset, so that both belong to
            # the same distance from the goal.
            latest = errors[-max(offsets.count, MIN_VIEWS) :]
            self._margin = margin = ArrivalMargin(
                scheme_output, observation, goal, latest.mean(axis=0),
                scheme.accuracy(observation, goal), ik_solution,
                latest.std(axis=0) / np.sqrt(len(latest)), offsets.scatter,
            )  # fmt: skip
            if self._ambiguous_poses is None or self._ambiguous_poses.goal is not goal:
                from .ambiguous_poses import AmbiguousPoses

                self._ambiguous_poses = AmbiguousPoses(goal)
            self._other_pose, self._possible_poses = self._ambiguous_poses.find_pose(observation)
            # If the scheme has a residual (error of a whole image), L describes the residual and
            # not the features.
            if scheme_output.residual is None:
                L = scheme_output.L / tolerances[:, None] / np.repeat((1.0, goal.distance), 3)
                self._view_check.set_expected_place(
                    observation, L, margin.compute_covariance(offsets), goal.distance
                )
        if self._images <= VIEW_PERIOD or self._images % VIEW_PERIOD == 0:
            mean_offset = self._offsets.errors[-len(self._view_check) :, :6].mean(axis=0)
            self._compare_views(
                self._margin.compute_offset(observation, mean_offset), scheme_output.ambiguity
            )
        uncertainty = self._margin.bound_uncertainty(
            observation, offsets, self._unseen_motion, self._possible_poses
        )
        return ArrivalStatus(True, "", self._wrong_pose_reason, uncertainty)

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

    def _add_offset(
        self, scheme_output: SchemeOutput, observation: Observation, free: np.ndarray | None,
        depth: float,
    ) -> None:
        """Store the camera's offset from its goal at this image.

        If L does not determine the offset, remove all stored offsets.
        """
        offset = compute_offset(scheme_output, free, depth)
        if offset is None:
            self._offsets.clear()
            return
        pose = observation.world_T_camera
        row = np.empty(22)
        row[:6], row[6:] = offset, np.nan if pose is None else pose.reshape(16)
        self._offsets.add(observation.stamp, row)
        if len(self._offsets) > MAX_WINDOW:
            self._offsets.drop_oldest(len(self._offsets) - MAX_WINDOW)

    def _has_settled(self, stamp: float, tolerances: np.ndarray) -> bool:
        """Return whether the mean error of the last `hold` seconds is within `tolerances` (k,)."""
        recent = self._errors
        # One image older than `hold` seconds is kept. It shows that the images cover the whole
        # averaging time.
        stamps = recent.stamps
        old_count = int(stamps.searchsorted(stamp - self.hold + ROUNDING, "right"))
        min_count = MIN_IMAGES if self.hold > 0.0 else 1
        if (dropped := min(old_count - 1, len(stamps) - min_count)) > 0:
            recent.drop_oldest(dropped)
            stamps = stamps[dropped:]
        if len(stamps) < min_count or stamp - stamps[0] < self.hold - ROUNDING:
            return False
        limit = tolerances * (HYSTERESIS if self._is_reached else 1.0)
        if not _is_within(recent.errors, limit):
            return False
        return len(recent) >= FEW_IMAGES or bool((np.abs(recent.errors) < limit).all())


def compute_mean_offset(
    stamps: np.ndarray,
    rows: np.ndarray,
    observable: np.ndarray,
    settled_images: int,
    was_reached: bool,
    depth: float = DEFAULT_DEPTH,
) -> tuple[PoseOffsets, str]:
    """Compute the mean offset of the camera from its goal, and describe why it is too large.

    Args:
        stamps: (m,) stamps of the images, s.
        rows: (m, 22) one row per image: the offset L^+ e (6,) in the camera's frame, m and rad, and
            `world_T_camera` (16,), NaN if the pose is unknown.
        observable: L^+ L (6, 6), which maps a camera motion to the change of the offset L^+ e.
        settled_images: number of images since the features settled.
        was_reached: whether the camera had arrived at the previous image.
        depth: depth of the target at the goal, m.

    Returns:
        The mean offset at the last image; a text that says why it is too large, empty if it is not.
    """
    near = GOAL_TOLERANCE[0] * depth, GOAL_TOLERANCE[1]
    mean, scatter, count, enough = _average_offsets(
        rows, observable, min(settled_images, FEW_IMAGES), np.array(near) / KNOWN_DEVIATIONS
    )
    latest, noise = rows[-1, :6], _estimate_noise(rows[-max(count, NOISE_STEPS) :, :6], depth)
    if (np.abs(latest - mean) > OUTLIER_DEVIATIONS * noise).any():
        mean, scatter, count = latest, np.diag(noise**2), 1
    off = _compute_lengths(mean.tolist())
    # Negative variances, which rounding errors can cause, are set to 0.
    deviations = np.sqrt(np.maximum(scatter.diagonal(), 0.0) / count)
    unknown = _compute_lengths((KNOWN_DEVIATIONS * deviations).tolist())
    offsets = PoseOffsets(mean, scatter, count, compute_speed(stamps, rows))
    if not (enough or was_reached) and len(rows) < MAX_WINDOW:
        return offsets, (
            "the features are within their tolerances, but they scatter: the pose of the camera is "
            f"known only to {1e3 * unknown[0]:.2f} mm and {np.degrees(unknown[1]):.2f} degrees"
        )
    limits = [HYSTERESIS * a + u if was_reached else max(a, u) for a, u in zip(
        near, unknown, strict=True
    )]  # fmt: skip
    if off[0] <= limits[0] and off[1] <= limits[1]:
        return _estimate_offset(offsets, rows, observable, settled_images, noise), ""
    return offsets, (
        "the features are within their tolerances, but according to L the camera is "
        f"{1e3 * off[0]:.2f} mm and {np.degrees(off[1]):.2f} degrees from its goal"
    )


def _estimate_offset(
    offsets: PoseOffsets,
    rows: np.ndarray,
    observable: np.ndarray,
    settled_images: int,
    noise: np.ndarray,
) -> PoseOffsets:
    """Return the more accurate of two mean offsets: of the latest images, or of all settled images.

    The mean over more images has less noise. But while the camera still approaches its goal, the
    older offsets are too large.

    Args:
        offsets: mean offset of the latest images.
        rows, observable, settled_images: see `compute_mean_offset`.
        noise: (6,) standard deviation of the offset of one image, m and rad.
    """
    mean, scatter, count, _ = _average_offsets(rows, observable, settled_images, NO_LIMIT)
    by_latest = offsets.scatter.diagonal() / offsets.count
    by_all = scatter.diagonal() / count
    if count <= offsets.count or (np.abs(rows[-1,
        :6] - mean) > OUTLIER_DEVIATIONS * noise).any() or not all(
        by_all[part].sum() < by_latest[part].sum() for part in (slice(0, 3), slice(3, 6))
    ):  # fmt: skip
        return offsets
    return offsets._replace(mean=mean, scatter=scatter, count=count)


def compute_speed(stamps: np.ndarray, rows: np.ndarray) -> tuple[float, float]:
    """Return the camera's speed relative to its goal between the last two images, m/s and rad/s.

    The speed is estimated from kinematics and from the images, and the smaller estimate is
    returned. The first is too large if the target moves with the camera, the second if the images
    are noisy.

    Args:
        stamps, rows: see `compute_mean_offset`.
    """
    if len(rows) < 2 or stamps[-1] <= stamps[-2]:
        return 0.0, 0.0
    by_images = _compute_lengths((rows[-1, :6] - rows[-2, :6]).tolist())
    # If the camera poses are unknown, the estimate by kinematics is NaN, and fmin returns the
    # estimate from the images.
    by_kinematics = _compute_lengths(_compute_motion_since(rows, len(rows) - 2).tolist())
    dt = float(stamps[-1] - stamps[-2])
    speeds = np.fmin(by_images, by_kinematics) / dt
    return float(speeds[0]), float(speeds[1])


def _estimate_noise(offsets: np.ndarray, depth: float = DEFAULT_DEPTH) -> np.ndarray:
    """Estimate the standard deviation (6,) of noisy offsets (m, 6), one per image.

    The estimate uses the differences of successive offsets. If there are enough images, it uses
    second differences, which a slow motion hardly changes.
    """
    order = 2 if len(offsets) > 2 else 1
    steps = offsets[1:] - offsets[:-1]
    if order == 2:
        steps = steps[1:] - steps[:-1]
    variance = (steps**2).sum(axis=0) / max(len(steps), 1) / (2.0, 6.0)[order - 1]
    length = ROUNDING * depth / DEFAULT_DEPTH
    return np.sqrt(variance) + np.array((length, length, length, ROUNDING, ROUNDING, ROUNDING))


def compute_offset(
    scheme_output: SchemeOutput, free: np.ndarray | None, depth: float
) -> np.ndarray | None:
    """Return the camera's offset L^+ e (6,) from the goal by one image, m and rad.

    The offset has only components along the directions `free` (f, 6) in which the task moves the
    camera. Return None if the scheme gives no L for its error.
    """
    L = scheme_output.L
    error = scheme_output.error if scheme_output.residual is None else scheme_output.residual
    if L is None or free is None or L.shape != (len(error), 6):
        return None
    L, error = np.asarray(L, float), np.asarray(error, float)
    if not is_task_finite(L, error):
        return None
    if len(L) > MAX_ROWS:
        scale = np.array((1.0, 1.0, 1.0, depth, depth, depth))
        L_free = (L / scale) @ free.T
        found = solve_least_squares(L_free.T @ L_free, L_free.T @ error, RANK_TOLERANCE**2)
        return found @ free / scale
    return _solve_offset(L, error, free, depth)


def _compute_observable(scheme_output: SchemeOutput, free: np.ndarray, depth: float) -> np.ndarray:
    """Return the matrix L^+ L (6, 6), which maps a camera motion to the change of the offset L^+ e.
    """
    scale = np.array((1.0, 1.0, 1.0, depth, depth, depth))
    L = np.asarray(scheme_output.L, float) / scale
    L_free, tolerance = L @ free.T, RANK_TOLERANCE
    if len(L) > MAX_ROWS:
        L, L_free, tolerance = L_free.T @ L, L_free.T @ L_free, RANK_TOLERANCE**2
    u, s, vt = svd(L_free)
    is_measured = s > tolerance * s[0]
    inverse = vt[is_measured].T / s[is_measured] @ u[:, is_measured].T
    return free.T @ inverse @ L * scale / scale[:, None]


def _compute_lengths(offset: Sequence[float]) -> tuple[float, float]:
    """Return the lengths of an offset's translation and rotation, m and rad."""
    return hypot(*offset[:3]), hypot(*offset[3:])


@jit("f8[:,:], f8[:], f8[:,:], f8")
def _solve_offset(L, error, free, depth):
    """Return the offset (6,) of `compute_offset` for given L (k, 6) and error (k,)."""
    scaled, turned = L.copy(), free.copy()
    for j in range(3, 6):
        for i in range(len(L)):
            scaled[i, j] /= depth
        for i in range(len(free)):
            turned[i, j] /= depth
    found = solve_least_squares(multiply(scaled, free.T), error, RANK_TOLERANCE)
    return multiply_vector(turned.T, found)


@jit("f8[:], f8[:]")
def _is_far(error, tolerances):
    """Return whether a component of the error (k,) exceeds FAR_TOLERANCES tolerances (k,)."""
    far = False
    for i in range(len(error)):
        far |= abs(error[i]) > FAR_TOLERANCES * tolerances[i]
    return far


@jit("f8[:,:], f8[:]")
def _is_within(errors, limit):
    """Return whether the mean errors of m images are within the limits (k,), with little scatter.

    The rms deviation of the errors (m, k) from their mean must be below MAX_SCATTER times the
    limit.
    """
    count = errors.shape[0]
    for k in range(errors.shape[1]):
        mean, square = 0.0, 0.0
        for i in range(count):
            mean += errors[i, k]
        mean /= count
        for i in range(count):
            square += (errors[i, k] - mean) ** 2
        if not (abs(mean) < limit[k] and square / count < (MAX_SCATTER * limit[k]) ** 2):
            return False
    return True


@jit("f8[:,:], i8")
def _compute_motion_since(rows, i):
    """Return the camera's motion (6,) from image i to the last image, in the last camera frame.

    The motion is small, so the rotation vector is the skew-symmetric part of the rotation matrix.

    Args:
        rows: (m, 22) offset and pose of each image, see `compute_mean_offset`.
    """
    last, k = rows.shape[0] - 1, 6
    motion, rotation = np.empty(6), np.zeros((3, 3))
    for a in range(3):
        motion[a] = 0.0
        for c in range(3):
            motion[a] += rows[last, k + 4 * c + a] * (
                rows[last, k + 4 * c + 3] - rows[i, k + 4 * c + 3]
            )
        for b in range(3):
            for c in range(3):
                rotation[a, b] += rows[i, k + 4 * c + a] * rows[last, k + 4 * c + b]
    motion[3] = 0.5 * (rotation[2, 1] - rotation[1, 2])
    motion[4] = 0.5 * (rotation[0, 2] - rotation[2, 0])
    motion[5] = 0.5 * (rotation[1, 0] - rotation[0, 1])
    return motion


@jit("f8[:,:], f8[:,:], i8, f8[:]")
def _average_offsets(rows, observable, count, limit):
    """Compute the mean offset of the latest images, transformed to the present camera pose.

    Args:
        rows: (m, 22) offset and pose of each image, the present one last; see
            `compute_mean_offset`.
        observable: L^+ L (6, 6), which maps a camera motion to the change of the offset L^+ e.
        count: smallest number of images to average. The number is doubled until the standard
            deviation of the mean is within `limit`.
        limit: (2,) largest standard deviation of the mean, m and rad.

    Returns:
        The mean (6,); the covariance (6, 6) of the offsets; the number of averaged images; whether
        the standard deviation of the mean is within `limit`.
    """
    m = rows.shape[0]
    count = min(max(count, 1), m)
    while True:
        # Sums of the offsets as measured (index 0), and of the offsets transformed to the camera's
        # present pose (index 1).
        total, square = np.zeros((2, 6)), np.zeros((2, 6, 6))
        off = np.empty((2, 6))
        for i in range(m - count, m):
            motion = _compute_motion_since(rows, i)
            for a in range(6):
                off[0, a] = off[1, a] = rows[i, a]
                for b in range(6):
                    off[1, a] += observable[a, b] * motion[b]
            for n in range(2):
                for a in range(6):
                    total[n, a] += off[n, a]
                    for b in range(6):
                        square[n, a, b] += off[n, a] * off[n, b]
        scatter, variances = np.empty(2), np.zeros((2, 2))
        for n in range(2):
            for a in range(6):
                mean = total[n, a] / count
                variances[n, a // 3] += max(square[n, a, a] / count - mean * mean, 0.0) / count
            scatter[n] = variances[n, 0] / limit[0] ** 2 + variances[n, 1] / limit[1] ** 2
        # If camera poses are unknown, scatter[1] is NaN and n becomes 0.
        n = 1 if scatter[1] <= scatter[0] else 0
        is_enough = variances[n, 0] <= limit[0] ** 2 and variances[n, 1] <= limit[1] ** 2
        if is_enough or count == m:
            mean, scattered = total[n] / count, square[n] / count
            for a in range(6):
                for b in range(6):
                    scattered[a, b] -= mean[a] * mean[b]
            return mean, scattered, count, is_enough
        count = min(2 * count, m)
