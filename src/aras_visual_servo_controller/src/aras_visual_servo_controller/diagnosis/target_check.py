"""Check whether the target moves.

The target moves if its own constant or periodic motion explains the part of the features' motion
that the camera's motion does not explain.
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


@dataclass(frozen=True, eq=False)
class _Row:
    """Motion of k features within ROW_PERIOD, in tolerances: one row of the fit.

    Attributes:
        stamp: middle of the period, s.
        feature_motion: (k,) measured motion.
        L: (k, 6) mean interaction matrix.
        motion: (6,) of the camera.
        drift: (k, 6) motion that a unit twist of the target causes in this period; the twist is in
            world axes, at the camera's position of the first row.
    """

    stamp: float
    feature_motion: np.ndarray
    L: np.ndarray
    motion: np.ndarray
    drift: np.ndarray


class _RowSums:
    """Rows added up in groups of `rows_per_sum`, n values in all, in tolerances.

    Attributes:
        feature_motion: (n,) measured motion of the features.
        motion_parts: (n, 6) motion predicted for each direction of the camera.
        rows_per_sum: number of rows in a sum.
    """

    def __init__(
        self,
        rows: Sequence[_Row],
        feature_motion: np.ndarray,
        motion_parts: np.ndarray,
        rows_per_sum: int,
    ) -> None:
        """Add up the rows.

        Args:
            rows: all m rows.
            feature_motion: (m, k) of these rows.
            motion_parts: (m, k, 6) of these rows.
            rows_per_sum: number of rows in a sum.
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
        """Return the effects (n, 18) of the camera's motion if each direction acted along any axis.
        """
        return self._sum_rows(np.array([_compute_mixed_effects(row) for row in self._rows]))

    @property
    def drift(self) -> np.ndarray:
        """Return the effects (n, 6) of a unit twist of the target."""
        return self._sum_rows(np.array([row.drift for row in self._rows]))

    @property
    def stamps(self) -> np.ndarray:
        """Return the time (n,) since the first row, s."""
        stamps = np.array([row.stamp for row in self._rows]).reshape(-1, self.rows_per_sum)
        stamps = stamps.mean(axis=1)
        return np.repeat(stamps - stamps[0], len(self._rows[0].feature_motion))

    @property
    def translation_effect(self) -> np.ndarray:
        """Return the effect (n,) of all translations of the camera."""
        return self.motion_parts[:, :3].sum(axis=1)

    @property
    def rotation_effect(self) -> np.ndarray:
        """Return the effect (n,) of all rotations of the camera."""
        return self.motion_parts[:, 3:].sum(axis=1)

    def fit_depth(self) -> float:
        """Fit the factor on the translations that explains the features' motion best."""
        along = self.translation_effect
        square = float(along @ along)
        return (
            along @ (self.feature_motion - self.rotation_effect) / square if square > 0.0 else 1.0
        )

    def compute_rest_residual(self, depth: float) -> np.ndarray:
        """Return the features' motion (n,) that a target at rest leaves unexplained.

        Args:
            depth: factor on the camera's translations.
        """
        return self.feature_motion - self.rotation_effect - depth * self.translation_effect


class TargetCheck:
    """Fit of the motion of the features over the last SPAN by the motions of camera and target.

    Three explanations are compared by the squared motion that they leave unexplained:

    - a target at rest and a correct camera model, except for the depth;
    - a target at rest and a wrong camera model (mounting, focal length): each direction of
      translation may act along every other, and likewise each rotation;
    - a target that moves with a constant twist, or oscillates at one frequency in addition.

    Measured on the simulated outcomes of tests/outcomes (30 images a second; kinematic arm and free
    camera): for a target that moves at 10 to 40 mm/s, the third explanation leaves 1e-5 of the
    residual of the first; for one that oscillates by 5 to 20 mm at 0.2 to 0.6 Hz at most 0.035; for
    a wrong mounting or focal length at least 0.2, and for image noise 0.9.
    """

    ROW_PERIOD = 0.12  # shortest duration of a row, s
    SPAN = 6.0  # time over which motion is fitted, s
    MIN_ROWS, CHECK_PERIOD = 10, 5  # rows before the first fit, and between two fits
    MIN_NUMBERS = 60  # smallest number of values: 18 factors would fit fewer of any kind
    # Numbers of rows that are added up if single rows show no motion: a target at 1 mm/s moves by
    # less than the tolerances within ROW_PERIOD, and a sum has no more noise than a row.
    # MIN_RESIDUAL: rms residual of the camera's motion, in tolerances, for which a motion of the
    # target is fitted. MIN_SUMMED_NUMBERS: smallest number of summed values.
    ROWS_PER_SUM, MIN_RESIDUAL, MIN_SUMMED_NUMBERS = (1, 3, 6, 12), (0.3, 0.3, 0.3, 0.15), 12
    MIN_OSCILLATION_SPAN = 2.5  # s of rows before an oscillation is fitted
    # largest residual with the target's motion, as a part of that of a target at rest
    MAX_RESIDUAL_PART = 0.1
    # largest residual with the target's motion, as a part of that of a wrong camera model
    MAX_CAMERA_PART = 0.5
    # Smallest factor on the camera's translation that a wrong depth can explain. If the features
    # move even less, the camera follows the target.
    MIN_DEPTH_FACTOR = 0.3
    # Smallest part of the predicted squared motion for which a wrong camera model is fitted
    # nevertheless: the camera may move in another direction than assumed.
    MIN_MOTION_PART = 0.2
    # Smallest scale of the motion along and about each direction that a wrong camera model can
    # explain: half the motion corresponds to another focal length, or a mounting error of 60
    # degrees.
    MIN_CAMERA_FACTOR = 0.5
    # residual below which a wrong camera model explains the motion as well
    CAMERA_EXPLAINS_PART = 0.02
    MAX_FREQUENCY = 1.5  # highest frequency of an oscillation that is fitted, Hz
    # normalised tolerance of the target's centre, used if the scheme's L is not of the present view
    CENTRE_TOLERANCE = 1e-3

    def __init__(self) -> None:
        # whether a wrong camera model explained the motion as well at the last fit
        self.has_camera_explanation = False
        self._rows: deque[_Row] = deque()
        self._origin = np.zeros(3)  # reference point of the target's twist, m, world axes
        self._new_rows = 0
        self._motion_text = ""
        # Error (k,), L (k, 6), error drift (k,) or (1,) and tolerances (k,) of the last image.
        self._last_measurement: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None = None
        self._start_row()

    @property
    def is_moving(self) -> bool:
        """Return whether the target moves according to the last fit."""
        return bool(self._motion_text)

    def interrupt(self) -> None:
        """Reset the comparison with the previous image, because an image had no measurement."""
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
        """Add one image and describe how the target moves; the text is empty if it is at rest.

        Args:
            scheme_output: measurement of the image.
            observation: of the image.
            goal: of the run.
            tolerances: (k,) of the error.
            is_current_interaction: whether L belongs to the present view; otherwise the target's
                centre is used.
            is_angle: (k,) bool, components that may wrap; None: all.
        """
        error, L, rate = scheme_output.error, scheme_output.L, scheme_output.error_drift
        if not is_current_interaction or np.shape(L) != (len(error), 6):
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
        """Start a new row of the fit at this image."""
        self._time, self._image_count = 0.0, 0
        self._motion = np.zeros(6)

    def _add_row(self, stamp: float, pose: np.ndarray) -> None:
        L = self._L / self._image_count
        rows = self._rows
        if rows and len(rows[-1].feature_motion) != len(self._feature_motion):
            rows.clear()
        if not rows:
            self._origin = pose[:3, 3]
        # Relative to the camera, the target's twist acts like a camera twist of opposite sign; at
        # the distance d from its reference point the velocity is v + w x d.
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
        """Describe how the target moves; the text is empty if it is at rest."""
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
                return ""  # a sum of n rows is at most n times as large
            if square >= min_residual**2 * count:
                if np.linalg.matrix_rank(self._rows[-1].L[:, :3]) < 2:
                    return ""  # L of rank 1 cannot locate the target
                return self._explain_motion(rows, depth, square)
        return ""

    def _explain_motion(self, rows: _RowSums, depth: float, residual: float) -> str:
        """Describe the target motion that explains the residual; the text is empty if none does."""
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
        # Only the deviation of the depth factor from 1 is fitted: a camera that follows its target
        # at constant speed does not move it in the image, and a factor of 0 must not explain that.
        constant, velocity = _fit_columns(columns[:, :4], motion - effect)
        if constant < bound:
            return f"it moves at {1e3 * float(np.linalg.norm(velocity[1:])):.1f} mm/s"
        # Sums are few and smooth, and rotations and oscillations fit half of them by chance, so
        # their bound is lower.
        bound = min(self.MAX_RESIDUAL_PART / rows.rows_per_sum**2 * residual, bound)
        # Fewer than six values per image cannot distinguish rotation from translation.
        columns = columns if len(self._rows[-1].feature_motion) >= 6 else columns[:, :4]
        if _fit_columns(columns, motion)[0] < bound:
            return "it rotates"
        return self._find_oscillation(rows.stamps, columns, motion, bound)

    def _find_oscillation(
        self, time: np.ndarray, columns: np.ndarray, feature_motion: np.ndarray, bound: float
    ) -> str:
        """Describe the oscillation whose residual is below the bound; empty if there is none.

        Args:
            time: (n,) s.
            columns: (n, m) effects of depth and of the target's constant twist.
            feature_motion: (n,) motion that is to be explained.
            bound: of the squared residual.
        """
        span = time[-1]
        if span < self.MIN_OSCILLATION_SPAN:
            return ""
        # The effects of depth and twist are projected out once for all frequencies.
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
    """Compute the target's centre (2,) from its moments, its L (2, 6), and its drift.

    The arrays are empty if moments or depth are unknown. The drift is 0.
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
    """Add the motion of the features between two images, and the mean of both L, in tolerances.

    Args:
        error_before, error: (k,) errors of the previous and the present image.
        L_before, L: (k, 6) their interaction matrices.
        error_drift_before, error_drift: (k,) or (1,) their drifts by the target's motion.
        tolerances_before, tolerances: (k,) their tolerances.
        dt: time between the two images, s.
        feature_motion: (k,) added to in place.
        interaction_sum: (k, 6) added to in place.
        is_angle: (k,) components that may wrap.

    Returns:
        True if an angle wrapped, that is, changed by more than any feature moves between two
        images.
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
    """Return the effects (k, 18) of the camera's motion if each direction acted along any axis."""
    return np.hstack([
        (row.L[:, first : first + 3, None] * row.motion[first : first + 3]).reshape(-1, 9)
        for first in (0, 3)
    ])  # fmt: skip


def _fit_camera(columns: np.ndarray, feature_motion: np.ndarray, min_factor: float) -> float:
    """Return the squared motion of the features that a wrong camera model leaves unexplained.

    The model allows each camera motion to act in any direction. It moves the features at least
    `min_factor` times as far as predicted; if they move less, the camera follows the target.

    Args:
        columns: (n, 18) see `_compute_mixed_effects`.
        feature_motion: (n,) measured motion.
        min_factor: smallest singular value of the fitted mixing matrices.
    """
    identity = np.vstack([np.eye(3)] * 2).ravel()
    _, factors = _fit_columns(columns, feature_motion - columns @ identity)
    U, scale, Vt = np.linalg.svd((identity + factors).reshape(2, 3, 3))
    mixing = U * np.maximum(scale, min_factor)[:, None, :] @ Vt
    residual = feature_motion - columns @ mixing.ravel()
    return float(residual @ residual)


def _fit_columns(columns: np.ndarray, values: np.ndarray) -> tuple[float, np.ndarray]:
    """Fit values (n,) by columns (n, m) in the least-squares sense.

    Returns:
        The squared residual, and the factors (m,).
    """
    # A small regularisation handles columns that are almost equal.
    normal = columns.T @ columns
    normal += (1e-9 * np.trace(normal) + 1e-300) * np.eye(len(normal))
    factors = np.linalg.solve(normal, columns.T @ values)
    rest = values - columns @ factors
    return float(rest @ rest), factors
