"""Whether the target moves: a motion of its own, constant or periodic, explains how the features
moved where the camera's motion does not."""

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
    """What happened within PERIOD; k features, in tolerances.

    moved: (k,) features. L: (k, 6) mean. motion: (6,) of the camera. drift: (k, 6) by which a
    target of the twist 1, at the camera's place of the first row, moves them in that time, world
    axes. stamp: s, of its middle.
    """

    stamp: float
    feature_motion: np.ndarray
    L: np.ndarray
    motion: np.ndarray
    drift: np.ndarray


class _RowSums:
    """Some rows, `together` of them added up each, n numbers in all, in tolerances.

    Attributes:
        moved: (n,) features. parts: (n, 6) by each direction of the camera as it is believed.
        together: how many rows are added up.
    """

    def __init__(
        self,
        rows: Sequence[_Row],
        feature_motion: np.ndarray,
        motion_parts: np.ndarray,
        rows_per_sum: int,
    ) -> None:
        """`moved` (m, k) and `parts` (m, k, 6) of all m rows."""
        count = len(rows) // rows_per_sum * rows_per_sum
        self._rows, self.rows_per_sum = list(rows)[len(rows) - count :], rows_per_sum
        self.feature_motion, self.motion_parts = (
            self._sum_rows(feature_motion[-count:]),
            self._sum_rows(motion_parts[-count:]),
        )

    def _sum_rows(self, values: np.ndarray) -> np.ndarray:
        whole = values.reshape(-1, self.rows_per_sum, *values.shape[1:]).sum(axis=1)
        return whole.reshape(-1, *whole.shape[2:])

    @property
    def mixed_effects(self) -> np.ndarray:
        """(n, 18) by each translation and rotation, if it is one along or about each axis."""
        return self._sum_rows(np.array([_compute_mixed_effects(row) for row in self._rows]))

    @property
    def drift(self) -> np.ndarray:
        """(n, 6) as of a row."""
        return self._sum_rows(np.array([row.drift for row in self._rows]))

    @property
    def stamps(self) -> np.ndarray:
        """(n,) s, from the first on."""
        stamps = np.array([row.stamp for row in self._rows]).reshape(-1, self.rows_per_sum)
        stamps = stamps.mean(axis=1)
        return np.repeat(stamps - stamps[0], len(self._rows[0].feature_motion))

    @property
    def translation_effect(self) -> np.ndarray:
        """(n,) by all translations of the camera."""
        return self.motion_parts[:, :3].sum(axis=1)

    @property
    def rotation_effect(self) -> np.ndarray:
        """(n,) by all its rotations."""
        return self.motion_parts[:, 3:].sum(axis=1)

    def fit_depth(self) -> float:
        """The factor of the translations that explains the features' motion best."""
        along = self.translation_effect
        square = float(along @ along)
        return (
            along @ (self.feature_motion - self.rotation_effect) / square if square > 0.0 else 1.0
        )

    def compute_rest_residual(self, depth: float) -> np.ndarray:
        """(n,) of the features' motion that a target at rest leaves, with a factor of depth."""
        return self.feature_motion - self.rotation_effect - depth * self.translation_effect


class TargetCheck:
    """Fits the features' motion by the camera's own and by the target's, over the last SPAN.

    Compared are three explanations, each by what it leaves of the square of the features' motion:

    - a target at rest before a camera as believed, but for one depth;
    - a camera that is not as believed: every direction of translation mixed into every other, and
      of rotation likewise (a mounting, a focal length);
    - a target with a constant twist, or that swings at one frequency besides.

    Measured on the campaign of outcomes (tests/outcomes; 30 images a second, chain and free): a
    target that moves at 10 to 40 mm/s leaves 1e-5 by the third of what is left by the first, one
    that swings by 5 to 20 mm at 0.2 to 0.6 Hz at most 0.035; a wrong mounting or focal length 0.2
    at least, and noise of the picture 0.9.
    """

    ROW_PERIOD = 0.12  # s of one row at least
    SPAN = 6.0  # s that are looked at
    MIN_ROWS, CHECK_PERIOD = 10, 5  # rows before anything is said, and between two looks
    MIN_NUMBERS = 60  # that the rows hold together, at least: 18 factors explain fewer of anything
    # Rows that are added up where one alone shows no motion: a target at 1 mm/s moves by less than
    # the tolerances within PERIOD. A sum has no more noise than a row. FEWER: its numbers.
    # LOUD: tolerances, rms, that the camera's motion has to leave in a row, or in a sum of rows.
    ROWS_PER_SUM, MIN_RESIDUAL, MIN_SUMMED_NUMBERS = (1, 3, 6, 12), (0.3, 0.3, 0.3, 0.15), 12
    MIN_OSCILLATION_SPAN = 2.5  # s of rows before a swing is looked for
    MAX_RESIDUAL_PART = 0.1  # part of that which the target's motion may leave, at most
    MAX_CAMERA_PART = 0.5  # part of what another camera leaves that it may leave, at most
    # The factor on the camera's translation that a wrong depth explains, at least. Where features
    # move less than that, no camera explains it: it is the target that the camera follows.
    MIN_DEPTH_FACTOR = 0.3
    # Part of the square by which the camera would move the features that they do move at least
    # where another camera is looked for all the same: one that flies elsewhere than it is believed.
    MIN_MOTION_PART = 0.2
    # The same of a camera, along and about each direction: half as far is another focal length, or
    # a mounting 60 degrees off.
    MIN_CAMERA_FACTOR = 0.5
    CAMERA_EXPLAINS_PART = 0.02  # part that another camera leaves at most that explains all as well
    MAX_FREQUENCY = 1.5  # Hz of a swing that is looked for
    # of the target's centre, normalised, where the scheme has no L of its view
    CENTRE_TOLERANCE = 1e-3

    def __init__(self) -> None:
        # whether at the last look another camera explained all as well
        self.has_camera_explanation = False
        self._rows: deque[_Row] = deque()
        self._origin = np.zeros(3)  # m, world axes: of the velocity of a target's twist
        self._new_rows = 0
        self._motion_text = ""
        # Error (k,), L (k, 6), rate (k,) or (1,) and tolerances (k,) of the last image.
        self._last_measurement: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None = None
        self._start_row()

    @property
    def is_moving(self) -> bool:
        """Whether the target moves, by what was found last."""
        return bool(self._motion_text)

    def interrupt(self) -> None:
        """An image without measurement: the next one has no predecessor."""
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
        """Take in one image; how the target moves, in words, empty where it does not.

        Args:
            tolerances: (k,) of the error.
            viewed: whether the decision's L is that of this view.
            angles: (k,) bool, of components that may wrap; None: all.
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
        """A row from this image on."""
        self._time, self._image_count = 0.0, 0
        self._motion = np.zeros(6)

    def _add_row(self, stamp: float, pose: np.ndarray) -> None:
        L = self._L / self._image_count
        rows = self._rows
        if rows and len(rows[-1].feature_motion) != len(self._feature_motion):
            rows.clear()
        if not rows:
            self._origin = pose[:3, 3]
        # A target's twist is the camera's against it: v + w x d at the distance d from the place
        # that v is of.
        camera_R_world = pose[:3, :3].T
        along, turned = L[:, :3] @ camera_R_world, L[:, 3:] @ camera_R_world
        drift = -self._time * np.hstack([along, turned - along @ skew(pose[:3, 3] - self._origin)])
        rows.append(_Row(stamp, self._feature_motion, L, self._motion, drift))
        while rows[0].stamp < stamp - self.SPAN:
            rows.popleft()
        self._start_row()
        self._new_rows += 1
        if len(rows) >= self.MIN_ROWS and self._new_rows >= self.CHECK_PERIOD:
            self._new_rows = 0
            self._motion_text = self._describe_motion()

    def _describe_motion(self) -> str:
        """How the target moves, as text; empty where it is at rest."""
        moved = np.array([row.feature_motion for row in self._rows])
        parts = np.array([row.L for row in self._rows])
        parts = parts * np.array([row.motion for row in self._rows])[:, None, :]
        for together, loud in zip(self.ROWS_PER_SUM, self.MIN_RESIDUAL, strict=True):
            count = len(self._rows) // together * len(self._rows[-1].feature_motion)
            if count < (self.MIN_NUMBERS if together == 1 else self.MIN_SUMMED_NUMBERS):
                return ""
            rows = _RowSums(self._rows, moved, parts, together)
            depth = rows.fit_depth()
            still = rows.compute_rest_residual(max(depth, self.MIN_DEPTH_FACTOR))
            left = float(still @ still)
            if together == 1 and left * self.ROWS_PER_SUM[-1]**2 < self.MIN_RESIDUAL[-1]**2 * count:
                return ""  # sums of n rows are n times as large, at most
            if left >= loud**2 * count:
                if np.linalg.matrix_rank(self._rows[-1].L[:, :3]) < 2:
                    return ""  # one direction alone has no place of a target
                return self._explain_motion(rows, depth, left)
        return ""

    def _explain_motion(self, rows: _RowSums, depth: float, residual: float) -> str:
        """The motion of a target that explains the square `residual`, as text; empty: none does."""
        along, moved = rows.translation_effect, rows.feature_motion - rows.rotation_effect
        known = np.column_stack([along, rows.drift])
        mixed = np.inf
        part = float(moved @ moved) / max(float(along @ along), 1e-12)
        if (
            depth > self.MIN_DEPTH_FACTOR
            or self.MIN_MOTION_PART < part < 1.0 / self.MIN_MOTION_PART
        ):
            mixed = _fit_camera(rows.mixed_effects, rows.feature_motion, self.MIN_CAMERA_FACTOR)
        self.has_camera_explanation = mixed < self.CAMERA_EXPLAINS_PART * residual
        bound = min(self.MAX_RESIDUAL_PART * residual, self.MAX_CAMERA_PART * mixed)
        # Of the depth's factor what it has beyond 1: a camera that follows its target at one speed
        # moves nothing in the picture, and no factor of 0 is to explain that.
        constant, velocity = _fit_columns(known[:, :4], moved - along)
        if constant < bound:
            return f"it moves at {1e3 * float(np.linalg.norm(velocity[1:])):.1f} mm/s"
        # Sums are few and smooth, which turns and swings explain by half: more is asked of those.
        bound = min(self.MAX_RESIDUAL_PART / rows.rows_per_sum**2 * residual, bound)
        # Few numbers an image do not tell a turn from a translation.
        known = known if len(self._rows[-1].feature_motion) >= 6 else known[:, :4]
        if _fit_columns(known, moved)[0] < bound:
            return "it turns"
        return self._find_oscillation(rows.stamps, known, moved, bound)

    def _find_oscillation(
        self, time: np.ndarray, columns: np.ndarray, feature_motion: np.ndarray, bound: float
    ) -> str:
        """The swing (Hz) that leaves less than the bound of the features' motion (n,), in words.

        Args:
            time: (n,) s. known: (n, m) by which depth and the target's constant twist move them.
        """
        span = time[-1]
        if span < self.MIN_OSCILLATION_SPAN:
            return ""
        # What is not the swing's is taken off once: the frequencies share it.
        base = np.linalg.qr(columns)[0]
        feature_motion = feature_motion - base @ (base.T @ feature_motion)
        least, found = np.inf, 0.0
        for frequency in np.arange(1.0 / span, self.MAX_FREQUENCY, 0.25 / span):
            phase = 2.0 * np.pi * frequency * time[:, None]
            waves = np.hstack([columns[:, 1:4] * np.cos(phase), columns[:, 1:4] * np.sin(phase)])
            left, _ = _fit_columns(waves - base @ (base.T @ waves), feature_motion)
            if left < least:
                least, found = left, frequency
        return f"it swings at {found:.2f} Hz" if least < bound else ""


def compute_centre(observation: Observation, goal: Goal) -> tuple[np.ndarray, np.ndarray, float]:
    """The target's centre (2,) normalised, its L (2, 6), and its rate, by its moments; (0,), (0, 6)
    where they are not known."""
    seen, wanted = observation.moments, goal.moments
    if seen is None or wanted is None or not goal.depth or seen.m00 <= 0.0:
        return np.zeros(0), np.zeros((0, 6)), 0.0
    depth = goal.depth * np.sqrt(wanted.m00 / seen.m00)
    centre = np.array([[seen.xg, seen.yg]])
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
    """Add how features moved from one image to the next, and the mean of both L, in tolerances, to
    moved (k,) and summed (k, 6); True where an angle wrapped: by more than any feature moves.

    rate_before, rate: (k,) or (1,); dt: s. angles: (k,) that may wrap.
    """
    wrapped = False
    for i in range(len(error)):
        before, now = error_before[i] / tolerances_before[i], error[i] / tolerances[i]
        wrapped |= is_angle[i] and abs((now - before) * tolerances[i]) > 1.0
        own = error_drift_before[min(i, len(error_drift_before) - 1)] / tolerances_before[i]
        own += error_drift[min(i, len(error_drift) - 1)] / tolerances[i]
        feature_motion[i] = feature_motion[i] + now - before - 0.5 * own * dt
        for j in range(6):
            mean = L_before[i, j] / tolerances_before[i] + L[i, j] / tolerances[i]
            interaction_sum[i, j] += 0.5 * mean
    return wrapped


def _compute_mixed_effects(row: _Row) -> np.ndarray:
    """(k, 18) by which each translation or rotation of the camera moves the features if it is one
    along or about each axis."""
    return np.hstack([
        (row.L[:, first : first + 3, None] * row.motion[first : first + 3]).reshape(-1, 9)
        for first in (0, 3)
    ])  # fmt: skip


def _fit_camera(columns: np.ndarray, feature_motion: np.ndarray, min_factor: float) -> float:
    """Square that a camera other than believed leaves of the features' motion (n,).

    A camera that moves, or turns, in any direction moves the features, `min_factor` times as far as
    believed or more: what would explain the motion by less is a target that is followed.

    Args:
        columns: (n, 18), see `_compute_mixed_effects`.
    """
    believed = np.vstack([np.eye(3)] * 2).ravel()
    _, factors = _fit_columns(columns, feature_motion - columns @ believed)
    U, scale, Vt = np.linalg.svd((believed + factors).reshape(2, 3, 3))
    mixing = U * np.maximum(scale, min_factor)[:, None, :] @ Vt
    rest = feature_motion - columns @ mixing.ravel()
    return float(rest @ rest)


def _fit_columns(columns: np.ndarray, values: np.ndarray) -> tuple[float, np.ndarray]:
    """Square that columns (n, m) leave of values (n,), and their factors (m,), least squares."""
    # A little weight against columns that are all but alike: they have no factor of their own.
    normal = columns.T @ columns
    normal += (1e-9 * np.trace(normal) + 1e-300) * np.eye(len(normal))
    factors = np.linalg.solve(normal, columns.T @ values)
    rest = values - columns @ factors
    return float(rest @ rest), factors
