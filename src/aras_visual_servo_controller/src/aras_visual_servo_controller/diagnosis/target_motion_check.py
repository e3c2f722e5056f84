"""Check whether the target moves.

The camera's motion explains only a part of the features' motion. The target moves if a constant or
periodic motion of the target explains the remaining part.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aras_visual_servo_base.compiled import jit
from aras_visual_servo_base.poses import skew
from aras_visual_servo_camera.interaction import point_interaction

from ..goals.goal import Goal
from ..observation.observation import Observation
from ..schemes.base import SchemeOutput


@dataclass(eq=False)
class _Row:
    """One row of the fit: motion of k features over at least ROW_PERIOD, in units of the tolerance.

    Attributes:
        stamp: middle of the period, s.
        feature_motion: (k,) measured motion.
        L: (k, 6) mean interaction matrix, in units of the tolerance.
        motion: (6,) motion of the camera.
        drift: (k, 6) motion of the features that each component of the target's twist causes in
            this period, per unit. The twist is in world axes; its reference point is the camera's
            position at the first row.
    """

    stamp: float
    feature_motion: np.ndarray
    L: np.ndarray
    motion: np.ndarray
    drift: np.ndarray


class _RowSums:
    """Sums over groups of `rows_per_sum` successive rows of the fit, in units of the tolerance.

    Attributes:
        feature_motion: (n,) measured motion of the features; n is the number of groups times the
            number of features.
        motion_parts: (n, 6) motion predicted for each direction of the camera.
        rows_per_sum: number of rows in a group.
    """

    def __init__(
        self,
        rows: Sequence[_Row],
        feature_motion: np.ndarray,
        motion_parts: np.ndarray,
        rows_per_sum: int,
    ) -> None:
        """Add up the measured and the predicted motion over groups of successive rows.

        Args:
            rows: the m rows, in the order of time.
            feature_motion: (m, k) measured motion of the features in each row.
            motion_parts: (m, k, 6) motion predicted for each row and each direction of the camera.
            rows_per_sum: number of rows in a group.
        """
        count = len(rows) // rows_per_sum * rows_per_sum
        self._rows, self.rows_per_sum = list(rows)[len(rows) - count :], rows_per_sum
        self.feature_motion, self.motion_parts = (
            self._sum_rows(feature_motion[-count:]),
            self._sum_rows(motion_parts[-count:]),
        )

    def _sum_rows(self, values: np.ndarray) -> np.ndarray:
        sums = values.reshape(-1, self.rows_per_sum, *values.shape[1:]).sum(axis=1)
        return sums.reshape(-1, *sums.shape[2:])

    @property
    def mixed_effects(self) -> np.ndarray:
        """Return the feature motions (n, 18) due to camera motions along wrong axes.

        See `_compute_mixed_effects`.
        """
        return self._sum_rows(np.array([_compute_mixed_effects(row) for row in self._rows]))

    @property
    def drift(self) -> np.ndarray:
        """Return the feature motions (n, 6) due to each component of a unit twist of the target."""
        return self._sum_rows(np.array([row.drift for row in self._rows]))

    @property
    def stamps(self) -> np.ndarray:
        """Return the time (n,) of each value since the first group, s."""
        stamps = np.array([row.stamp for row in self._rows]).reshape(-1, self.rows_per_sum)
        stamps = stamps.mean(axis=1)
        return np.repeat(stamps - stamps[0], len(self._rows[0].feature_motion))

    @property
    def translation_effect(self) -> np.ndarray:
        """Return the feature motions (n,) due to all translations of the camera."""
        return self.motion_parts[:, :3].sum(axis=1)

    @property
    def rotation_effect(self) -> np.ndarray:
        """Return the feature motions (n,) due to all rotations of the camera."""
        return self.motion_parts[:, 3:].sum(axis=1)

    def fit_depth(self) -> float:
        """Return the factor on the camera's translations that best explains the feature motion."""
        along = self.translation_effect
        square = float(along @ along)
        return (
            along @ (self.feature_motion - self.rotation_effect) / square if square > 0.0 else 1.0
        )

    def compute_rest_residual(self, depth: float) -> np.ndarray:
        """Return the feature motions (n,) that the camera's motion does not explain.

        Args:
            depth: factor on the camera's translations.
        """
        return self.feature_motion - self.rotation_effect - depth * self.translation_effect


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
        self._rows: deque[_Row] = deque()
        self._origin = np.zeros(3)  # reference point of the target's twist, in m and world axes
        self._new_rows = 0
        self._motion_text = ""
        # Error (k,), L (k, 6), error drift (k,) or (1,), and tolerances (k,) of the last image.
        self._last_measurement: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None = None
        self._start_row()

    @property
    def is_moving(self) -> bool:
        """Return whether the target moves according to the last fit."""
        return bool(self._motion_text)

    def interrupt(self) -> None:
        """Forget the previous image, because the image after it had no measurement."""
        self._last_measurement = None
        self._start_row()

    def add(
        self,
        scheme_output: SchemeOutput,
        observation: Observation,
        goal: Goal,
        tolerances: np.ndarray,
        is_current_interaction: bool,
        is_angle: np.ndarray | None = None,
    ) -> str:
        """Add one image and describe how the target moves; empty text if it is at rest.

        Args:
            scheme_output: measurement of the image.
            observation: observation of the image.
            goal: goal of the run.
            tolerances: (k,) tolerance of each component of the error.
            is_current_interaction: whether L belongs to the present view; otherwise the target's
                centre is used.
            is_angle: (k,) whether each component is an angle, which may wrap; None if all may wrap.
        """
        error, L, rate = scheme_output.error, scheme_output.L, scheme_output.error_drift
        if not is_current_interaction or L is None or L.shape != (len(error), 6):
            error, L, rate = compute_centre(observation, goal)
            tolerances, is_angle = np.full(len(error), self.CENTRE_TOLERANCE), None
        is_angle = np.ones(len(error), bool) if is_angle is None else is_angle
        rate = np.array(rate, float, ndmin=1)
        now = np.asarray(error, float), np.asarray(L, float), rate, tolerances
        before, self._last_measurement = self._last_measurement, now
        motion, pose = observation.motion, observation.world_T_camera
        if before is None or motion is None or pose is None or len(before[0]) != len(error):
            self._start_row()
            return self._motion_text
        if not self._image_count:
            self._feature_motion, self._L = np.zeros(len(error)), np.zeros((len(error), 6))
        dt = observation.dt
        if not len(error) or _add_step(
            *before, *now, dt, self._feature_motion, self._L, is_angle
        ):
            self._start_row()
            return self._motion_text
        self._time += dt
        self._image_count += 1
        self._motion = self._motion + motion
        if self._time >= self.ROW_PERIOD:
            self._add_row(observation.stamp - 0.5 * self._time, pose)
        return self._motion_text

    def _start_row(self) -> None:
        """Start a new row of the fit, which sums the motions after this image."""
        self._time, self._image_count = 0.0, 0
        self._motion = np.zeros(6)

    def _add_row(self, stamp: float, pose: np.ndarray) -> None:
        L = self._L / self._image_count
        rows = self._rows
        if rows and len(rows[-1].feature_motion) != len(self._feature_motion):
            rows.clear()
        if not rows:
            self._origin = pose[:3, 3]
        # A twist v, w of the target changes the image like the opposite twist of the camera. At the
        # distance d from the twist's reference point, the target's velocity is v + w x d.
        camera_R_world = pose[:3, :3].T
        translation_L, rotation_L = L[:, :3] @ camera_R_world, L[:, 3:] @ camera_R_world
        lever = skew(pose[:3, 3] - self._origin)
        drift = -self._time * np.hstack([translation_L, rotation_L - translation_L @ lever])
        rows.append(_Row(stamp, self._feature_motion, L, self._motion, drift))
        while rows[0].stamp < stamp - self.SPAN:
            rows.popleft()
        self._start_row()
        self._new_rows += 1
        if len(rows) >= self.MIN_ROWS and self._new_rows >= self.CHECK_PERIOD:
            self._new_rows = 0
            self._motion_text = self._describe_motion()

    def _describe_motion(self) -> str:
        """Describe how the target moves; empty text if it is at rest."""
        feature_motion = np.array([row.feature_motion for row in self._rows])
        parts = np.array([row.L for row in self._rows])
        parts = parts * np.array([row.motion for row in self._rows])[:, None, :]
        for group, min_residual in zip(self.ROWS_PER_SUM, self.MIN_RESIDUAL, strict=True):
            count = len(self._rows) // group * len(self._rows[-1].feature_motion)
            if count < (self.MIN_NUMBERS if group == 1 else self.MIN_SUMMED_NUMBERS):
                return ""
            rows = _RowSums(self._rows, feature_motion, parts, group)
            depth = rows.fit_depth()
            rest = rows.compute_rest_residual(max(depth, self.MIN_DEPTH_FACTOR))
            square = float(rest @ rest)
            if group == 1 and square * self.ROWS_PER_SUM[-1]**2 < self.MIN_RESIDUAL[-1]**2 * count:
                return ""  # too small for MIN_RESIDUAL, even if all rows are summed in groups
            if square >= min_residual**2 * count:
                if np.linalg.matrix_rank(self._rows[-1].L[:, :3]) < 2:
                    return ""  # L of rank 1 does not determine the target's motion
                return self._explain_motion(rows, depth, square)
        return ""

    def _explain_motion(self, rows: _RowSums, depth: float, residual: float) -> str:
        """Describe the target motion that explains the features' motion; empty text if none does.

        Args:
            rows: measured motion of the features, and the effects of the camera's and target's
                motions.
            depth: fitted factor on the camera's translations.
            residual: squared motion of the features that the camera's motion does not explain.
        """
        effect, motion = rows.translation_effect, rows.feature_motion - rows.rotation_effect
        columns = np.column_stack([effect, rows.drift])
        camera_residual = np.inf
        motion_part = float(motion @ motion) / max(float(effect @ effect), 1e-12)
        if (
            depth > self.MIN_DEPTH_FACTOR
            or self.MIN_MOTION_PART < motion_part < 1.0 / self.MIN_MOTION_PART
        ):
            camera_residual = _fit_camera(
                rows.mixed_effects, rows.feature_motion, self.MIN_CAMERA_FACTOR
            )
        self.has_camera_explanation = camera_residual < self.CAMERA_EXPLAINS_PART * residual
        bound = min(self.MAX_RESIDUAL_PART * residual, self.MAX_CAMERA_PART * camera_residual)
        # If the camera follows its target at constant speed, the features do not move. The fit must
        # then find the velocity of the target and not a depth factor of 0. Therefore its first
        # column fits only the deviation of the depth factor from 1, which is kept small by
        # regularisation.
        constant, velocity = _fit_columns(columns[:, :4], motion - effect)
        if constant < bound:
            return f"it moves at {1e3 * float(np.linalg.norm(velocity[1:])):.1f} mm/s"
        # Large groups give few sums, which change smoothly. A rotation or an oscillation may
        # explain half of them by chance, so a smaller residual is required for larger groups.
        bound = min(self.MAX_RESIDUAL_PART / rows.rows_per_sum**2 * residual, bound)
        # With fewer than six feature values per image, a rotation cannot be distinguished from a
        # translation.
        columns = columns if len(self._rows[-1].feature_motion) >= 6 else columns[:, :4]
        if _fit_columns(columns, motion)[0] < bound:
            return "it rotates"
        return self._find_oscillation(rows.stamps, columns, motion, bound)

    def _find_oscillation(
        self, time: np.ndarray, columns: np.ndarray, feature_motion: np.ndarray, bound: float
    ) -> str:
        """Describe the oscillation whose residual is below the bound; empty text if there is none.

        Args:
            time: (n,) time of each value, s.
            columns: (n, m) effects of a wrong depth and of a constant twist of the target.
            feature_motion: (n,) motion of the features that is to be explained.
            bound: upper bound of the squared residual.
        """
        span = time[-1]
        if span < self.MIN_OSCILLATION_SPAN:
            return ""
        # The effects of a wrong depth and of a constant twist are the same at all frequencies. They
        # are therefore subtracted from the motion before oscillations are fitted.
        base = np.linalg.qr(columns)[0]
        feature_motion = feature_motion - base @ (base.T @ feature_motion)
        min_residual, best_frequency = np.inf, 0.0
        for frequency in np.arange(1.0 / span, self.MAX_FREQUENCY, 0.25 / span):
            phase = 2.0 * np.pi * frequency * time[:, None]
            waves = np.hstack([columns[:, 1:4] * np.cos(phase), columns[:, 1:4] * np.sin(phase)])
            residual, _ = _fit_columns(waves - base @ (base.T @ waves), feature_motion)
            if residual < min_residual:
                min_residual, best_frequency = residual, frequency
        return f"it oscillates at {best_frequency:.2f} Hz" if min_residual < bound else ""


def compute_centre(observation: Observation, goal: Goal) -> tuple[np.ndarray, np.ndarray, float]:
    """Compute the target's centre from its moments, with its interaction matrix and drift.

    Returns:
        The centre (2,), normalised; its L (2, 6); its drift, which is 0. The arrays are empty if
        the moments or the depth are unknown.
    """
    measured, desired = observation.moments, goal.moments
    if measured is None or desired is None or not goal.depth or measured.m00 <= 0.0:
        return np.zeros(0), np.zeros((0, 6)), 0.0
    depth = goal.depth * np.sqrt(desired.m00 / measured.m00)
    centre = np.array([[measured.xg, measured.yg]])
    return centre[0], point_interaction(centre, np.array([1.0 / depth])), 0.0


@jit("f8[:], f8[:,:], f8[:], f8[:], f8[:], f8[:,:], f8[:], f8[:], f8, f8[::1], f8[:,::1], "
          "b1[:]", allocates=False)
def _add_step(
    error_before,
    L_before,
    error_drift_before,
    tolerances_before,
    error,
    L,
    error_drift,
    tolerances,
    dt,
    feature_motion,
    interaction_sum,
    is_angle,
):
    """Add the motion of the features between two images, and the mean L of these images.

    Motion and L are divided by the tolerances.

    Args:
        error_before, error: (k,) error at the previous and at the present image.
        L_before, L: (k, 6) interaction matrix at each of the two images.
        error_drift_before, error_drift: (k,) or (1,) rate of each error component due to the
            target's motion, per s.
        tolerances_before, tolerances: (k,) tolerances at each of the two images.
        dt: time between the two images, s.
        feature_motion: (k,) sum of the feature motions; modified in place.
        interaction_sum: (k, 6) sum of the mean L; modified in place.
        is_angle: (k,) whether each component is an angle, which may wrap.

    Returns:
        Whether an angle has wrapped, that is, has changed by more than 1 rad.
    """
    wrapped = False
    for i in range(len(error)):
        before, now = error_before[i] / tolerances_before[i], error[i] / tolerances[i]
        wrapped |= is_angle[i] and abs((now - before) * tolerances[i]) > 1.0
        drift = error_drift_before[min(i, len(error_drift_before) - 1)] / tolerances_before[i]
        drift += error_drift[min(i, len(error_drift) - 1)] / tolerances[i]
        feature_motion[i] = feature_motion[i] + now - before - 0.5 * drift * dt
        for j in range(6):
            mean = L_before[i, j] / tolerances_before[i] + L[i, j] / tolerances[i]
            interaction_sum[i, j] += 0.5 * mean
    return wrapped


def _compute_mixed_effects(row: _Row) -> np.ndarray:
    """Return the feature motions (k, 18) due to camera motions along wrong axes.

    There is a column for each of the nine pairs of axes: the feature motion if the camera's
    translation along the first axis acted along the second axis. Nine more columns are for
    rotations.
    """
    return np.hstack([
        (row.L[:, first : first + 3, None] * row.motion[first : first + 3]).reshape(-1, 9)
        for first in (0, 3)
    ])  # fmt: skip


def _fit_camera(columns: np.ndarray, feature_motion: np.ndarray, min_factor: float) -> float:
    """Return the squared motion of the features that a wrong camera model does not explain.

    With a wrong camera model, a camera motion along one axis may act along any other axis. Such a
    motion has to move the features at least `min_factor` times as far as predicted. If the features
    move less, the camera follows a moving target.

    Args:
        columns: (n, 18) effects of the camera's motion, see `_compute_mixed_effects`.
        feature_motion: (n,) measured motion of the features.
        min_factor: smallest accepted ratio of the fitted to the predicted effect of a translation
            or a rotation about any axis.
    """
    identity = np.vstack([np.eye(3)] * 2).ravel()
    _, factors = _fit_columns(columns, feature_motion - columns @ identity)
    U, scale, Vt = np.linalg.svd((identity + factors).reshape(2, 3, 3))
    mixing = U * np.maximum(scale, min_factor)[:, None, :] @ Vt
    residual = feature_motion - columns @ mixing.ravel()
    return float(residual @ residual)


def _fit_columns(columns: np.ndarray, values: np.ndarray) -> tuple[float, np.ndarray]:
    """Fit values (n,) by a linear combination of columns (n, m) in the least-squares sense.

    Returns:
        The squared residual, and the factors (m,) of the columns.
    """
    # A small regularisation makes the least-squares solution unique if two columns are almost
    # equal.
    normal = columns.T @ columns
    normal += (1e-9 * np.trace(normal) + 1e-300) * np.eye(len(normal))
    factors = np.linalg.solve(normal, columns.T @ values)
    rest = values - columns @ factors
    return float(rest @ rest), factors
