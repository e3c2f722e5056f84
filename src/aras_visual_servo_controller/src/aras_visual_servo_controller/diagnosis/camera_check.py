"""Whether the camera's motion explains how the features moved, with the camera as believed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from aras_visual_servo_base.compiled import jit

from ..kinematics.joint_sample import JointSample
from ..kinematics.task import DIRECTIONS
from ..observation.observation import Observation
from ..schemes.base import SchemeOutput


class CameraCheck:
    """Compares how the features moved with how L and the executed motion say they had to.

    A wrong depth makes all translations count too much or too little by one factor, and does no
    harm; a wrong focal length, mounting or distortion is no such factor. So each direction of the
    camera gets a scale, fitted over the whole run: with a camera as believed, those of the
    translations are alike and those of the rotations are 1. Translations are compared with each
    other, two and two. What moves slowly is added up over some images.

    Measured on the simulated arm: healthy runs leave 0.06 % of the motion unexplained with moments
    and 1.6 % with points, and no two of their scales differ by more than 0.04 and 2.4 deviations at
    once; a loaded machine's leave 2.7 %, 0.4 tolerances an image. A focal length of 0.9 times the
    true one has scales 0.10 apart at 11 deviations where the camera comes down by a centimetre and
    moves aside; where it does one of the two alone, that cannot be told from another depth.

    What a scheme says of the target's own motion (`SchemeOutput.error_drift`) is taken off first.
    Noise of the picture is no wrong camera: what is not explained has to go on from row to row.
    Of a wrong
    mounting it does by 0.8 (of 1), of noise by -0.5, of a target that was pushed once by 0.

    The mean L tells a step only as far as L hardly changes in it. Of one in which it does (a scheme
    that leads the camera astray turns it by 20 degrees from image to image) nothing is said.

    How the arm moved is known as well as its joints are at the exposures. Where those are guessed,
    as when joint states come late, nothing is compared. Where the joints' speeds at both ends do
    not explain their way (a loaded machine's late commands shake the arm between two joint states),
    the image weighs less, by how far the features may be off for it.
    """

    # Tolerances from one row to the next: of less, noise and the joints' friction would be judged.
    MIN_ROW = 3.0
    # images that are one row at most: what is slower may be the target's own motion
    MAX_IMAGES_PER_ROW = 4
    MIN_PATH = 40.0  # tolerances of predicted way before anything is judged
    # Part of the motion's square that one depth does not explain, and in tolerances of an image.
    MAX_MISFIT_PART, MIN_MISFIT = 0.04, 1.5
    MIN_CORRELATION = 0.2  # correlation of what is not explained with that of the next row
    # A scale counts as wrong when it is off by so much, and so many standard deviations more.
    MIN_DIFFERENCE, MIN_DEVIATIONS = 0.04, 4.0
    # Tolerances that a direction alone moved the features, for its scale to be judged: of a
    # translation beside another, of a rotation (joints that shake tilt the camera unseen).
    MIN_TRANSLATION, MIN_ROTATION = 3.0, 8.0
    MIN_NOISE = 0.05  # tolerances of noise that there are at least
    SHAKING_FACTOR = 0.3  # part of the most that shaken features are off, in a recorded run, in rms
    LATE_PART = 0.25  # part of an image period for which joints went on at a speed that had changed
    # Part of the predicted way by which L changes it from one image to the next, and in tolerances,
    # up to which the mean of both tells it: of half turns by six moments, where it changes by 0.5
    # to 2, a third of that way is not explained.
    BENT = 0.3

    def __init__(self, jacobian: Callable[[np.ndarray], np.ndarray] | None = None) -> None:
        """`jacobian`: (6, n) of the arm at joints (n,); None: its motion is taken as it is."""
        self._jacobian = jacobian
        self._joints: JointSample | None = None
        self._last_measurement: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self._normal, self._right = np.zeros((6, 6)), np.zeros(6)
        self._square = self._path_length = 0.0
        # Of each row with the one before it: sums as those above.
        self._last_row: tuple[np.ndarray, np.ndarray] | None = None
        self._next_normal, self._next_right = np.zeros((6, 6)), np.zeros(6)
        self._next_square = 0.0
        self._rows = 0
        self._fault: str | None = ""

    def interrupt(self) -> None:
        """An image without measurement: the next one has no predecessor."""
        self._last_measurement = self._joints = self._last_row = None

    def add(
        self, scheme_output: SchemeOutput, observation: Observation, tolerances: np.ndarray,
        is_angle: np.ndarray | None = None,
    ) -> None:
        """Take in one image.

        Args:
            tolerances: (k,) of the error.
            angles: (k,) bool, of components that may wrap; None: all.
        """
        is_angle = np.ones(len(tolerances), bool) if is_angle is None else is_angle
        L, error = scheme_output.L, scheme_output.error
        before, self._last_measurement = self._last_measurement, None
        joints, self._joints = self._joints, observation.joints
        if L is None or np.shape(L) != (len(error), 6):
            return
        self._last_measurement = (
            error,
            np.asarray(L, float),
            np.array(scheme_output.error_drift, float, ndmin=1),
        )
        if before is None or observation.motion is None or len(before[0]) != len(error):
            self._start_row(error)
            return
        predicted, wrapped, bent = _predict_motion(
            *before, *self._last_measurement, observation.motion, observation.dt, tolerances,
            self._parts,
            self._target_motion, is_angle,
        )  # fmt: skip
        if wrapped or bent > max(self.BENT * predicted, self.MIN_ROW):
            self._start_row(error)
            return
        self._images += 1
        self._shaking = max(
            self._shaking,
            self._estimate_shaking(
                joints, observation.joints, self._last_measurement[1], tolerances
            ),
        )
        if predicted >= self.MIN_ROW:
            self._add_row(predicted, (error - self._start_error - self._target_motion) / tolerances)
        if predicted >= self.MIN_ROW or self._images >= self.MAX_IMAGES_PER_ROW:
            self._start_row(error)

    def _start_row(self, error: np.ndarray) -> None:
        """A row from this image on, where the error is (k,)."""
        self._start_error, self._parts = error, np.zeros((len(error), 6))
        self._images, self._shaking, self._target_motion = 0, 0.0, np.zeros(len(error))

    def _add_row(self, predicted: float, measured: np.ndarray) -> None:
        """Take in how far the features moved (k,), and had to at most, in tolerances."""
        weight = 1.0 / (1.0 + self.SHAKING_FACTOR * self._shaking)
        parts, measured = weight * self._parts, weight * measured
        self._normal += parts.T @ parts
        self._right += parts.T @ measured
        self._square += float(measured @ measured)
        if self._last_row is not None and len(self._last_row[1]) == len(measured):
            before, moved = self._last_row
            self._next_normal += before.T @ parts
            self._next_right += before.T @ measured + parts.T @ moved
            self._next_square += float(moved @ measured)
        self._last_row = parts, measured
        self._path_length += weight * predicted
        self._rows += len(measured)
        self._fault = None

    def _estimate_shaking(
        self,
        before: JointSample | None,
        now: JointSample | None,
        L: np.ndarray,
        tolerances: np.ndarray,
    ) -> float:
        """How far at most the features moved otherwise than the joints tell, in tolerances."""
        if self._jacobian is None or before is None or now is None:
            return 0.0
        return _compute_unexplained(
            before.positions, before.velocities, now.positions, now.velocities,
            now.stamp - before.stamp, self.LATE_PART, self._jacobian(now.positions), L, tolerances,
        )  # fmt: skip

    def find_fault(self) -> str:
        """What cannot be with the camera as believed, in words; empty where all can."""
        if self._fault is None:
            self._fault = self._evaluate() if self._path_length > self.MIN_PATH else ""
        return self._fault

    def _evaluate(self) -> str:
        depth, misfit, rest, one, other, scale, beside = _fit_scales(
            self._normal, self._right, self._square, self._rows,
            self.MIN_TRANSLATION, self.MIN_ROTATION, self.MIN_DIFFERENCE, self.MIN_DEVIATIONS,
            self.MIN_NOISE,
        )  # fmt: skip
        words = "the features move otherwise than L and the arm's motion say"
        if depth <= 0.0:
            return f"{words}: against the camera's translation"
        if (
            misfit > self.MAX_MISFIT_PART
            and rest > self.MIN_MISFIT
            and self._is_smooth(depth, misfit)
        ):
            return f"{words}: {100.0 * misfit:.0f} % of the motion is not explained"
        if one < 0:
            return ""
        elsewhere = "elsewhere" if one == other else f"along {DIRECTIONS[other]}"
        return (
            f"along {DIRECTIONS[one]} the features move {scale:.2f} times as far as L and "
            f"the arm's motion say, {elsewhere} {beside:.2f} times"
        )

    def _is_smooth(self, depth: float, misfit: float) -> bool:
        """Whether what one depth leaves unexplained, a part of the motion's square, goes on from
        row to row."""
        scale = np.array([depth] * 3 + [1.0] * 3)
        product = self._next_square - scale @ self._next_right + scale @ self._next_normal @ scale
        return bool(product > self.MIN_CORRELATION * misfit * self._square)


@jit("f8[:,:]")
def _invert(matrix):
    """Of a symmetric positive definite one (n, n), which needs no pivots; by Gauss and Jordan."""
    left, right, count = matrix.copy(), np.eye(len(matrix)), len(matrix)
    for i in range(count):
        pivot = left[i, i]
        for j in range(count):
            left[i, j], right[i, j] = left[i, j] / pivot, right[i, j] / pivot
        for k in range(count):
            if k == i:
                continue
            factor = left[k, i]
            for j in range(count):
                left[k, j] -= factor * left[i, j]
                right[k, j] -= factor * right[i, j]
    return right


@jit("f8[:,:], f8[:], f8, f8, f8, f8, f8, f8, f8")
def _fit_scales(
    normal,
    right,
    square,
    rows,
    min_translation,
    min_rotation,
    min_difference,
    deviations,
    min_noise,
):
    """How far the features moved in each direction of the camera, beside what was expected.

    Two translations are compared with each other, a rotation with 1.

    Args:
        normal, right, square: (6, 6), (6,) of the normal equations, and the motion's square.
        rows: how many numbers went into them.
        known, turned, off, deviations, quiet: as CameraCheck has them.

    Returns:
        The factor of the translations, with rotations as they are expected; what it leaves
        unexplained, as a part of the motion's square and in tolerances, rms; the direction whose
        scale is wrong, and the one beside it, itself for a rotation, -1 where none is; its scale;
        the other's, 1 for a rotation.
    """
    moved = straight = turning = 0.0
    for i in range(3):
        straight += right[i]
        for j in range(3):
            moved += normal[i, j]
            turning += normal[i, 3 + j]
    depth = (straight - turning) / moved if moved > min_translation**2 else 1.0
    expected, damped = np.ones(6), normal.copy()
    for i in range(6):
        expected[i] = depth if i < 3 else 1.0
        damped[i, i] += 0.1  # where nothing was seen, it is as expected
    spread = _invert(damped)
    scale, left, misfit = np.zeros(6), square, square
    for i in range(6):
        for j in range(6):
            scale[i] += spread[i, j] * (right[j] + 0.1 * expected[j])
    for i in range(6):
        left -= 2.0 * right[i] * scale[i]
        misfit -= 2.0 * right[i] * expected[i]
        for j in range(6):
            left += scale[i] * normal[i, j] * scale[j]
            misfit += expected[i] * normal[i, j] * expected[j]
    noise = max(np.sqrt(max(left, 0.0) / max(rows - 6.0, 1.0)), min_noise)
    one, other, most = -1, -1, 0.0
    for i in range(6):
        for j in range(i if i < 3 else 1):
            turns = i > 2
            away = scale[i] - (1.0 if turns else scale[j])
            variance = spread[i, i]
            if not turns:
                variance += spread[j, j] - 2.0 * spread[i, j]
            unknown, unit = np.sqrt(variance), 1.0 if turns else abs(depth)
            # What is not explained may be the motion's own uncertainty, which makes scales small.
            lowered = max(left, 0.0) * variance
            over = (abs(away) - deviations * noise * unknown) / unit - lowered - min_difference
            if unknown <= 1.0 / (min_rotation if turns else min_translation) and over > most:
                one, other, most = i, i if turns else j, over
    if one != other and abs(scale[one] - 1.0) < abs(scale[other] - 1.0):
        one, other = other, one
    beside = 1.0 if one == other else scale[other]
    rest = np.sqrt(max(misfit, 0.0) / rows)
    return depth, misfit / square, rest, one, other, scale[max(one, 0)], beside


@jit("f8[:], f8[:,:], f8[:], f8[:], f8[:,:], f8[:], f8[:], f8, f8[:], f8[:,::1], f8[::1], "
          "b1[:]", allocates=False)
def _predict_motion(
    error_before,
    L_before,
    error_drift_before,
    error,
    L,
    error_drift,
    motion,
    dt,
    tolerances,
    parts,
    target_motion,
    is_angle,
):
    """Add what each direction of the camera should have done to the features up to this image, and
    what was no doing of the camera's.

    Args:
        error_before, error: (k,); L_before, L: (k, 6); rate_before, rate: (k,) or (1,), at the two
            last images.
        motion: (6,) of the camera between them; dt: s.
        tolerances: (k,), the unit of `parts`.
        parts, own: (k, 6), (k,) up to the image before; they are added to.
        angles: (k,) whether it may wrap.

    Returns:
        The greatest of the sums of `parts`; whether an error moved so far that an angle wrapped;
        the most that both L differ in what they say of this step, in tolerances.
    """
    widest, greatest, wrapped, bent = 0.0, 0.0, False, 0.0
    for i in range(len(error)):
        if is_angle[i]:
            widest = max(widest, tolerances[i])
    for i in range(len(error)):
        predicted = changed = 0.0
        for j in range(6):
            parts[i, j] += 0.5 * (L_before[i, j] + L[i, j]) * motion[j] / tolerances[i]
            predicted += parts[i, j]
            changed += (L[i, j] - L_before[i, j]) * motion[j] / tolerances[i]
        bent = max(bent, abs(changed))
        greatest = max(greatest, abs(predicted))
        if is_angle[i]:
            wrapped |= abs(error[i] - error_before[i]) / tolerances[i] > 1.0 / widest
        both = (
            error_drift_before[min(i, len(error_drift_before) - 1)]
            + error_drift[min(i, len(error_drift) - 1)]
        )
        target_motion[i] += 0.5 * both * dt
    return greatest, wrapped, bent


@jit("f8[:], f8[:], f8[:], f8[:], f8, f8, f8[:,:], f8[:,:], f8[:]", allocates=False)
def _compute_unexplained(q_before, v_before, q, v, dt, late, jacobian, L, tolerances):
    """Most that a joint's motion moves a feature which its speeds (n,) do not explain, in
    tolerances (k,).

    Args:
        q_before, v_before, q, v: (n,) positions and speeds, dt (s) apart.
        late: part of dt for which a speed that changed may have gone on.
        jacobian, L: (6, n), (k, 6).
    """
    most = 0.0
    for j in range(len(q)):
        change = v[j] - v_before[j]
        told = (v_before[j] + 0.5 * change) * dt
        unexplained = abs(q[j] - q_before[j] - told) + late * dt * abs(change)
        for i in range(len(L)):
            moved = 0.0
            for k in range(6):
                moved += L[i, k] * (jacobian[k, j] * unexplained)
            most = max(most, abs(moved / tolerances[i]))
    return most
