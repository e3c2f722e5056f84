"""Check whether the target moves.

The camera's motion explains only a part of the features' motion. The target moves if a constant or
periodic motion of the target explains the remaining part.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from aras_visual_servo_base.compiled import jit
from aras_visual_servo_camera.interaction import point_interaction

from ..goals.goal import Goal
from ..observation.observation import Observation
from .feature_rows import DRIFT, ERROR, FIRST_L, IS_ANGLE, TOLERANCE, FeatureHistory
from .motion_fits import (
    compute_mixed_effects,
    fit_camera,
    fit_columns,
    fit_depth,
    fit_oscillation,
    sum_groups,
)
from .vector_history import VectorHistory

# Columns of a row of the fit: motion and pose of the camera. The last column is the duration.
MOTION, POSE = slice(-23, -17), slice(-17, -1)


class TargetMotionCheck:
    """Fit of the features' motion over the last SPAN seconds by the motions of camera and target.

    Three explanations are compared. The residual of an explanation is the sum of the squared
    feature motions that it does not explain.

    - The target is at rest and the camera model is correct, except for the depth.
    - The target is at rest and the camera model is wrong (mounting, focal length): a translation
      along one axis may have the effect of a translation along another axis, and likewise a
      rotation.
    - The target moves with a constant twist, and may also oscillate at one frequency.

    The ratio of the third residual to the first one was measured in simulations with 30 images per
    second. It is 1e-5 for a target that moves at 10 to 40 mm/s, at most 0.035 for a target that
    oscillates by 5 to 20 mm at 0.2 to 0.6 Hz, at least 0.2 for a wrong mounting or focal length,
    and 0.9 for image noise.
    """

    ROW_PERIOD = 0.12  # motions are summed over at least this time (s) to one row of the fit
    SPAN = 6.0  # time over which the target's motion is fitted, s
    MIN_ROWS = 10  # number of rows (motions of ROW_PERIOD) before the first fit
    CHECK_PERIOD = 5  # number of new rows (motions of ROW_PERIOD) between two fits
    # Smallest number of values in a fit to single rows. A wrong camera model is fitted with 18
    # factors, which would explain a smaller set of values even if the target moved.
    MIN_NUMBERS = 60
    # Numbers of successive rows that are summed before a fit. Larger sums are used if smaller ones
    # show no motion: a target at 1 mm/s moves by less than the tolerances within ROW_PERIOD, but a
    # sum over many rows shows its motion, and has no more noise than one row.
    ROWS_PER_SUM = (1, 3, 6, 12)
    # A motion of the target is fitted only if the rms residual for a target at rest exceeds this,
    # in units of the tolerance. There is one value for each number in ROWS_PER_SUM.
    MIN_RESIDUAL = (0.3, 0.3, 0.3, 0.15)
    MIN_SUMMED_NUMBERS = 12  # smallest number of values in a fit if rows are summed in groups
    # An oscillation of the target is fitted only to rows that cover at least this time, s.
    MIN_OSCILLATION_SPAN = 2.5
    # The target moves if a motion of the target reduces the residual to less than this fraction of
    # the residual for a target at rest.
    MAX_RESIDUAL_PART = 0.1
    # A moving target is reported only if its residual is also less than this fraction of the
    # residual for a wrong camera model.
    MAX_CAMERA_PART = 0.5
    # Smallest factor on the camera's translations that a wrong depth can explain. A smaller factor
    # shows that the camera follows a moving target.
    MIN_DEPTH_FACTOR = 0.3
    # A wrong camera model is also fitted if the features have moved about as far as predicted: if
    # the ratio of measured to predicted squared motion is between MIN_MOTION_PART and 1 /
    # MIN_MOTION_PART. The camera may then have moved in another direction than predicted.
    MIN_MOTION_PART = 0.2
    # Smallest scale of the translation along or the rotation about an axis that a wrong camera
    # model can explain. A scale of 0.5 corresponds to a focal length that is wrong by a factor of
    # two, or to a mounting error of 60 degrees.
    MIN_CAMERA_FACTOR = 0.5
    # A wrong camera model explains the motion as well as a moving target does if its residual is
    # less than this fraction of the residual for a target at rest.
    CAMERA_EXPLAINS_PART = 0.02
    MAX_FREQUENCY = 1.5  # highest frequency of an oscillation that is fitted, Hz
    # Tolerance of the target's centre in normalised coordinates. The centre is used instead of the
    # features if the scheme's L does not belong to the present view.
    CENTRE_TOLERANCE = 1e-3

    def __init__(self) -> None:
        # Whether, at the last fit, a wrong camera model explained the features' motion as well as a
        # moving target did.
        self.has_camera_explanation = False
        # Rows of the fit: motion of the k features over at least ROW_PERIOD (k), mean L (6 k),
        # motion due to the camera's translation (k) and motion without the effect of its rotation
        # (k), motion (6,) and pose (16,) of the camera, and duration (s). Feature motions and L are
        # in units of the tolerance. The stamp is the middle of the period.
        self._rows = VectorHistory(self.SPAN)
        # Reference point of the target's twist, in m and world axes: the camera's position at the
        # first row.
        self._origin = np.zeros(3)
        self._new_rows = 0
        self._motion_text = ""
        self._centre = FeatureHistory()  # position of the target's centre
        self._features: np.ndarray | None = None  # features of the last image
        # Present row of the fit: sums over its images, duration, s, and number of images.
        self._row, self._time, self._image_count = np.empty(0), 0.0, 0

    @property
    def is_moving(self) -> bool:
        """Return whether the target moves according to the last fit."""
        return bool(self._motion_text)

    def add(self, features: FeatureHistory | None, observation: Observation, goal: Goal) -> str:
        """Add one image and describe how the target moves; empty text if it is at rest.

        Args:
            features: features of the image and of the one before it; None if L does not belong to
                the present view. The target's centre is then used instead, and also if there is no
                L.
            observation: observation of the image.
            goal: goal of the run.
        """
        if features is None or features.now is None:
            centre, L = compute_centre(observation, goal)
            features = self._centre
            features.add(observation, centre, L, 0.0, self.CENTRE_TOLERANCE, True)
        # The check has not processed the image before this one if an earlier diagnosis reported an
        # outcome for it.
        before = features.before if features.before is self._features else None
        now, pose = features.now, observation.world_T_camera
        self._features = now
        if before is None or pose is None or not now.size:
            self._image_count = 0
            return self._motion_text
        if not self._image_count:
            self._row, self._time = np.zeros(9 * len(now) - MOTION.start), 0.0
        if _add_step(before, now, observation.motion, observation.dt, self._row):
            self._image_count = 0  # start a new row
            return self._motion_text
        self._time += observation.dt
        self._image_count += 1
        if self._time >= self.ROW_PERIOD:
            self._add_row(observation.stamp - 0.5 * self._time, pose)
        return self._motion_text

    def _add_row(self, stamp: float, pose: np.ndarray) -> None:
        row, rows = self._row, self._rows
        _finish_row(row, self._image_count, pose, self._time)
        if rows.rows.shape[1] != row.size:
            # There is no row yet, or the number of features has changed.
            self._origin = pose[:3, 3]
        rows.add(stamp, row)
        self._image_count = 0
        self._new_rows += 1
        if len(rows.rows) >= self.MIN_ROWS and self._new_rows >= self.CHECK_PERIOD:
            self._new_rows = 0
            self._motion_text = self._describe_motion()

    def _describe_motion(self) -> str:
        """Describe how the target moves; empty text if it is at rest."""
        rows = self._rows.rows
        count = (rows.shape[1] + MOTION.start) // 9
        along, rest_motion = rows[:, 7 * count : 8 * count], rows[:, 8 * count : 9 * count]
        for size, min_residual in zip(self.ROWS_PER_SUM, self.MIN_RESIDUAL, strict=True):
            numbers = len(rows) // size * count
            if numbers < (self.MIN_NUMBERS if size == 1 else self.MIN_SUMMED_NUMBERS):
                return ""
            effect, moved = sum_groups(along, size), sum_groups(rest_motion, size)
            depth = fit_depth(effect, moved)
            rest = moved - max(depth, self.MIN_DEPTH_FACTOR) * effect
            square = float(rest @ rest)
            if size == 1 and square * self.ROWS_PER_SUM[-1]**2 < self.MIN_RESIDUAL[-1]**2 * numbers:
                return ""  # too small for MIN_RESIDUAL, even if all rows are summed in groups
            if square >= min_residual**2 * numbers:
                L = rows[:, count : 7 * count].reshape(-1, count, 6)
                return self._explain_motion(L, effect, moved, size, square)
        return ""

    def _explain_motion(
        self, L: np.ndarray, effect: np.ndarray, moved: np.ndarray, size: int, residual: float
    ) -> str:
        """Describe the target motion that explains the features' motion; empty text if none does.

        Args:
            L: (m, k, 6) mean L of each row of the fit, in units of the tolerance.
            effect: (n,) motions that the camera's translations predict, summed over groups of rows.
            moved: (n,) measured motions minus the effect of the camera's rotations, likewise.
            size: number of rows in each group.
            residual: squared motion of the features that the camera's motion does not explain.
        """
        columns = np.column_stack([effect, sum_groups(self._compute_drifts(L), size)])
        camera_bound = None
        for text, fitted, largest_part in self._fit_motions(columns, moved, size, L.shape[1]):
            if fitted >= largest_part * residual:
                continue
            if camera_bound is None:
                if np.linalg.matrix_rank(L[-1, :, :3]) < 2:
                    return ""  # L of rank 1 does not determine the target's motion
                camera = self._fit_camera(L, effect, moved, size)
                self.has_camera_explanation = camera < self.CAMERA_EXPLAINS_PART * residual
                camera_bound = self.MAX_CAMERA_PART * camera
            if fitted < camera_bound:
                return text
        return ""

    def _fit_motions(
        self, columns: np.ndarray, moved: np.ndarray, size: int, count: int
    ) -> Iterator[tuple[str, float, float]]:
        """Fit motions of the target to the features' motion, the simplest first.

        Args:
            columns: (n, 7) effects of the camera's translations and of a unit twist of the target.
            moved: (n,) measured motions minus the effect of the camera's rotations.
            size: number of rows of the fit in each group.
            count: number of features.

        Yields:
            Text that describes the motion; the squared residual of its fit; the largest residual
            that is accepted, as a fraction of the residual for a target at rest.
        """
        # If the camera follows its target at constant speed, the features do not move. The fit must
        # then find the velocity of the target and not a depth factor of 0. Therefore its first
        # column fits only the deviation of the depth factor from 1, which is kept small by
        # regularisation.
        constant, velocity = fit_columns(columns[:, :4], moved - columns[:, 0])
        speed = 1e3 * float(np.linalg.norm(velocity[1:]))
        yield f"it moves at {speed:.1f} mm/s", constant, self.MAX_RESIDUAL_PART
        # Large groups give few sums, which change smoothly. A rotation or an oscillation may
        # explain half of them by chance, so a smaller residual is required for larger groups.
        largest_part = self.MAX_RESIDUAL_PART / size**2
        # With fewer than six feature values per image, a rotation cannot be distinguished from a
        # translation.
        columns = columns if count >= 6 else columns[:, :4]
        yield "it rotates", fit_columns(columns, moved)[0], largest_part
        stamps = sum_groups(self._rows.stamps, size) / size
        stamps = stamps - stamps[0]
        if stamps[-1] >= self.MIN_OSCILLATION_SPAN:
            frequency, residual = fit_oscillation(stamps, columns, moved, self.MAX_FREQUENCY)
            yield f"it oscillates at {frequency:.2f} Hz", residual, largest_part

    def _fit_camera(
        self, L: np.ndarray, effect: np.ndarray, moved: np.ndarray, size: int
    ) -> float:
        """Return the squared motion of the features that a wrong camera model does not explain.

        Return inf if the camera follows a moving target, so that no camera model is fitted. See
        `_explain_motion` for the arguments.
        """
        rows = self._rows.rows
        motion_part = float(moved @ moved) / max(float(effect @ effect), 1e-12)
        if fit_depth(effect, moved) <= self.MIN_DEPTH_FACTOR and not (
            self.MIN_MOTION_PART < motion_part < 1.0 / self.MIN_MOTION_PART
        ):
            return np.inf
        return fit_camera(
            sum_groups(compute_mixed_effects(L, rows[:, MOTION]), size),
            sum_groups(rows[:, : L.shape[1]], size), self.MIN_CAMERA_FACTOR,
        )  # fmt: skip

    def _compute_drifts(self, L: np.ndarray) -> np.ndarray:
        """Return the feature motions (m, k, 6) due to each component of a unit twist of the target.

        The twist is in world axes; its reference point is `_origin`. A twist v, w of the target
        changes the image like the opposite twist of the camera. At the distance d from the
        reference point, the target's velocity is v + w x d.
        """
        pose, duration = self._rows.rows[:, POSE].reshape(-1, 4, 4), self._rows.rows[:, -1]
        camera_R_world = pose[:, :3, :3].swapaxes(1, 2)
        along, about = L[:, :, :3] @ camera_R_world, L[:, :, 3:] @ camera_R_world
        turned = np.cross(along, pose[:, None, :3, 3] - self._origin)
        return -duration[:, None, None] * np.concatenate([along, about - turned], axis=2)

def compute_centre(observation: Observation, goal: Goal) -> tuple[np.ndarray, np.ndarray]:
    """Compute the target's centre from its moments, with its interaction matrix.

    Returns:
        The centre (2,), normalised; its L (2, 6). The arrays are empty if the moments or the depth
        are unknown.
    """
    measured, desired = observation.moments, goal.moments
    if measured is None or desired is None or not goal.depth or measured.m00 <= 0.0:
        return np.zeros(0), np.zeros((0, 6))
    depth = goal.depth * np.sqrt(desired.m00 / measured.m00)
    centre = np.array([[measured.xg, measured.yg]])
    return centre[0], point_interaction(centre, np.array([1.0 / depth]))


@jit("f8[:,::1], f8[:,::1], f8[:], f8, f8[::1]", allocates=False)
def _add_step(before, now, motion, dt, row):
    """Add the motions of features and camera between two images, and the mean L of these images.

    The motion of the features and L are divided by the tolerances.

    Args:
        before, now: (k, 10) features of the previous and of the present image, see `feature_rows`.
        motion: (6,) motion of the camera between the two images.
        dt: time between the two images, s.
        row: (9 k + 23,) row of the fit, see `TargetMotionCheck`; the sums of the feature motions
            (k,), of the mean L (6 k,) and of the camera's motion (6,) are modified in place.

    Returns:
        Whether an angle has wrapped, that is, has changed by more than 1 rad.
    """
    wrapped, count = False, len(now)
    for j in range(6):
        row[9 * count + j] += motion[j]
    for i in range(count):
        tolerance_before, tolerance = before[i, TOLERANCE], now[i, TOLERANCE]
        error_before, error = before[i, ERROR] / tolerance_before, now[i, ERROR] / tolerance
        wrapped |= now[i, IS_ANGLE] > 0.0 and abs((error - error_before) * tolerance) > 1.0
        drift = before[i, DRIFT] / tolerance_before
        drift += now[i, DRIFT] / tolerance
        row[i] = row[i] + error - error_before - 0.5 * drift * dt
        for j in range(6):
            mean = before[i, FIRST_L + j] / tolerance_before + now[i, FIRST_L + j] / tolerance
            row[count + 6 * i + j] += 0.5 * mean
    return wrapped


@jit("f8[::1], f8, f8[:,:], f8", allocates=False)
def _finish_row(row, image_count, pose, duration):
    """Complete a row of the fit after its last image, see `TargetMotionCheck`."""
    count = (len(row) - 23) // 9
    for i in range(count):
        translated = rotated = 0.0
        for j in range(6):
            place = count + 6 * i + j
            row[place] /= image_count
            if j < 3:
                translated += row[place] * row[9 * count + j]
            else:
                rotated += row[place] * row[9 * count + j]
        row[7 * count + i], row[8 * count + i] = translated, row[i] - rotated
    for i in range(4):
        for j in range(4):
            row[9 * count + 6 + 4 * i + j] = pose[i, j]
    row[len(row) - 1] = duration
