"""Check whether the camera's motion explains the motion of the features."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from aras_visual_servo_base.compiled import jit

from ..kinematics.joint_sample import JointSample
from ..kinematics.task import DIRECTIONS
from ..observation.observation import Observation
from .feature_rows import DRIFT, ERROR, FIRST_L, IS_ANGLE, TOLERANCE, FeatureHistory

# A row of the fit sums the motion of the features over successive images until the predicted
# motion reaches this, in units of the tolerance. In a smaller sum, noise and joint friction
# would dominate.
MIN_ROW = 3.0
# Largest number of images per row of the fit. If the features move by less than MIN_ROW in so
# many images, these images are discarded, because the target itself may have moved.
MAX_IMAGES_PER_ROW = 4
# The fit is evaluated once the predicted motions of the features add up to this, in units of
# the tolerance.
MIN_PATH = 40.0
# One factor on all translations, which accounts for a wrong depth, is fitted to the motion of
# the features. The camera model is wrong if the residual of this fit exceeds both
# MAX_MISFIT_PART and MIN_MISFIT.
MAX_MISFIT_PART = 0.04  # residual as a fraction of the squared motion
MIN_MISFIT = 1.5  # rms residual, in units of the tolerance
# A wrong camera model is reported only if the correlation between the residuals of successive
# rows of the fit is at least this.
MIN_CORRELATION = 0.2
# The scale of a camera motion (measured / predicted motion of the features) is wrong if it
# differs from its expected value by more than MIN_DIFFERENCE plus MIN_DEVIATIONS standard
# deviations.
MIN_DIFFERENCE, MIN_DEVIATIONS = 0.04, 4.0
# The scale of a translation is evaluated only if the translation alone has moved the features
# by at least this many tolerances.
MIN_TRANSLATION = 3.0
# The scale of a rotation is evaluated only if the rotation alone has moved the features by at
# least this many tolerances. The limit is larger than for a translation, because shaking joints
# tilt the camera by angles that are not measured.
MIN_ROTATION = 8.0
# Lower bound of the estimated noise of a summed motion, in units of the tolerance.
MIN_NOISE = 0.05
# Ratio of the rms motion of the features due to shaking joints to the upper bound that
# `_estimate_shaking` computes. It was measured in a recorded run.
SHAKING_FACTOR = 0.3
# Largest delay of a change of the joint speeds, as a fraction of an image period.
LATE_PART = 0.25
# A pair of images is used only if its motions predicted by the first L and by the second L
# differ by less than this fraction of the motion. With larger differences, the mean of both L
# is inaccurate: near a rotation of 180 degrees it leaves a third of the motion of moments
# unexplained.
MAX_L_CHANGE = 0.3
NO_ROW = np.empty((0, 7))


class CameraModelCheck:
    """Check of the camera model: features must move as L and the camera's motion predict.

    For each of the six directions of camera motion, the check fits a scale: the ratio of measured
    to predicted motion of the features. With a correct camera model, the scales of the three
    rotations are 1. The scales of the three translations are equal to each other; a wrong depth
    changes them together and is not a fault. A wrong focal length, mounting or distortion gives
    different scales.

    The fit is a linear least-squares problem. Each of its rows is the sum of the feature motions
    over up to MAX_IMAGES_PER_ROW images, so that even a slow motion exceeds the noise. The target's
    own motion that a scheme reports (`SchemeOutput.error_drift`) is subtracted first.

    A wrong camera model is reported only if the residuals of successive rows are correlated with
    each other. This correlation is 0.8 for a wrong mounting, -0.5 for image noise and 0 for a
    target that was pushed once.

    Measured on the simulated arm with a correct camera model, the fit leaves 0.06 % of the squared
    motion of moments unexplained, and up to 2.7 % for points. No two scales differ both by more
    than 0.04 and by more than 2.4 standard deviations. With 0.9 times the true focal length, the
    scales differ by 0.10, or 11 standard deviations, if the camera both descends by a centimetre
    and moves sideways. If it makes only one of these motions, a wrong focal length has the same
    effect as a wrong depth.

    Image pairs are skipped if L changes much between them, because their mean L then does not
    predict the change of the features. They are also skipped if joint states arrive late, because
    the camera's motion is computed from the joint positions at the exposures. If the joint speeds
    at two images do not explain how far the joints moved in between, the pair gets a smaller
    weight.

    Attributes:
        fault: last result of `find_fault`; None after a new row of the fit.
    """

    def __init__(self, jacobian: Callable[[np.ndarray], np.ndarray] | None = None) -> None:
        """Create the check.

        Args:
            jacobian: function from joints (n,) to the arm's Jacobian (6, n); None if the camera's
                motion is exact.
        """
        self._jacobian = jacobian
        self._stamp = -np.inf  # stamp of the last image, s
        self._joints: JointSample | None = None  # joints of the last image
        # Sums of the products (7, 7) of the rows of the fit with themselves, which are its normal
        # equations, and with the rows before them, which give the correlation of the residuals. A
        # row (k, 7) is the predicted motion (k, 6) and the measured motion (k,).
        self._products, self._next_products = np.zeros((7, 7)), np.zeros((7, 7))
        self._last_row, self._path_length, self._count = NO_ROW, 0.0, 0
        # Present row: features at its start; sums of `_predict_motion`; for each of its images, the
        # joints at the previous and at this image, and the features.
        self._start, self._sums = np.empty((0, 10)), NO_ROW
        self._images: list[tuple[JointSample | None, JointSample | None, np.ndarray]] = []
        self.fault: str | None = ""

    def add(self, features: FeatureHistory, observation: Observation) -> None:
        """Add one image.

        Args:
            features: features of the image and of the one before it.
            observation: observation of the image.
        """
        # The check has not processed the image before this one if an earlier diagnosis reported an
        # outcome for it.
        is_next = observation.stamp - observation.dt <= self._stamp + features.SAME_STAMP
        joints, self._joints, self._stamp = self._joints, observation.joints, observation.stamp
        now, before, images = features.now, features.before, self._images
        if now is None:
            return
        if before is None or not is_next:
            self._last_row, self._start = NO_ROW, now
            images.clear()
            return
        if not images:
            self._sums = np.zeros((now.shape[0], 7))
        predicted, L_change = _predict_motion(
            before, now, observation.motion, observation.dt, self._sums
        )
        images.append((joints, observation.joints, now))
        is_usable = not L_change > max(MAX_L_CHANGE * predicted, MIN_ROW)
        if is_usable and predicted >= MIN_ROW:
            self._add_row(predicted)
        elif is_usable and len(images) < MAX_IMAGES_PER_ROW:
            return
        self._start = now
        images.clear()

    def _add_row(self, predicted: float) -> None:
        """Add the sums over the latest images to the normal equations, as one row of the fit.

        The argument is the largest predicted motion of a feature, in units of the tolerance.
        """
        # Upper bound of the feature motion that the joint speeds do not explain, in units of the
        # tolerance: between two images, a joint may move differently than its speeds predict.
        shaking = 0.0
        for before, now, features in self._images:
            if self._jacobian is not None and before is not None and now is not None:
                shaking = max(shaking, _compute_unexplained(
                    before.positions, before.velocities, now.positions, now.velocities,
                    now.stamp - before.stamp, LATE_PART, self._jacobian(now.positions),
                    features,
                ))  # fmt: skip
        weight = 1.0 / (1.0 + SHAKING_FACTOR * shaking)
        _finish_row(
            self._start, self._images[-1][2], weight, self._sums, self._last_row, self._products,
            self._next_products,
        )  # fmt: skip
        self._last_row = self._sums
        self._path_length += weight * predicted
        self._count += len(self._sums)
        self.fault = None

    def find_fault(self) -> str:
        """Evaluate the fit, and describe how the features contradict the camera model.

        Return an empty text if they do not.
        """
        if self._path_length <= MIN_PATH:
            return ""
        depth, misfit, rest, direction, other_direction, scale, other_scale = _fit_scales(
            self._products, self._count
        )
        text = "the features do not move as L and the arm's motion predict"
        if depth <= 0.0:
            return f"{text}: when the camera translates, they move in the opposite direction"
        is_unexplained = misfit > MAX_MISFIT_PART and rest > MIN_MISFIT
        if is_unexplained and self._is_smooth(depth, misfit):
            return f"{text}: {100.0 * misfit:.0f} % of the motion is not explained"
        if direction < 0:
            return ""
        where = (
            "in other directions"
            if direction == other_direction
            else f"along {DIRECTIONS[other_direction]}"
        )
        return (
            f"along {DIRECTIONS[direction]} the features move {scale:.2f} times as far as L and "
            f"the arm's motion predict, but {where} {other_scale:.2f} times as far"
        )

    def _is_smooth(self, depth: float, misfit: float) -> bool:
        """Return whether successive rows of the fit have correlated residuals.

        Args:
            depth: fitted factor on all translations; the factor on the rotations is 1.
            misfit: residual of the fit as a fraction of the squared motion of the features.
        """
        scale = np.array([depth] * 3 + [1.0] * 3 + [-1.0])
        product = scale @ self._next_products @ scale
        return bool(product > MIN_CORRELATION * misfit * self._products[6, 6])


@jit("f8[:,:]")
def _invert(matrix):
    """Invert a symmetric positive definite matrix (n, n) by Gauss-Jordan elimination.

    A positive definite matrix needs no pivoting.
    """
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


@jit("f8[:,:], f8")
def _fit_scales(products, count):
    """Fit a scale of the features' motion to each direction of the camera, and find a wrong scale.

    The scales of the translations are compared with each other in pairs, and the scale of each
    rotation is compared with 1.

    Args:
        products: (7, 7) normal equations of the fit, see `CameraModelCheck`.
        count: number of measured motions of the features.

    Returns:
        Seven values. The first three belong to a fit in which all translations share one factor and
        the rotations have the factor 1: this factor; the residual as a fraction of the squared
        motion; the rms residual in units of the tolerance. The other four describe the wrong scale:
        the index of its direction, -1 if no scale is wrong; the index of the direction that it is
        compared with, the same for a rotation; and both scales, the second of which is 1 for a
        rotation.
    """
    normal, right, square = products[:6, :6], products[:6, 6], products[6, 6]
    translation_square = translation_right = coupling = 0.0
    for i in range(3):
        translation_right += right[i]
        for j in range(3):
            translation_square += normal[i, j]
            coupling += normal[i, 3 + j]
    depth = 1.0
    if translation_square > MIN_TRANSLATION**2:
        depth = (translation_right - coupling) / translation_square
    expected, damped = np.ones(6), normal.copy()
    for i in range(6):
        expected[i] = depth if i < 3 else 1.0
        damped[i, i] += 0.1  # regularisation: a direction without motion keeps its expected scale
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
    noise = max(np.sqrt(max(left, 0.0) / max(count - 6.0, 1.0)), MIN_NOISE)
    first, second, greatest = -1, -1, 0.0
    for i in range(6):
        for j in range(i if i < 3 else 1):
            is_rotation = i > 2
            difference = scale[i] - (1.0 if is_rotation else scale[j])
            variance = spread[i, i]
            if not is_rotation:
                variance += spread[j, j] - 2.0 * spread[i, j]
            deviation, unit = np.sqrt(variance), 1.0 if is_rotation else abs(depth)
            # Errors of the measured camera motion reduce the fitted scales by about this amount.
            bias = max(left, 0.0) * variance
            excess = (abs(difference) - MIN_DEVIATIONS * noise * deviation) / unit - bias
            excess -= MIN_DIFFERENCE
            min_motion = MIN_ROTATION if is_rotation else MIN_TRANSLATION
            if deviation <= 1.0 / min_motion and excess > greatest:
                first, second, greatest = i, i if is_rotation else j, excess
    if first != second and abs(scale[first] - 1.0) < abs(scale[second] - 1.0):
        first, second = second, first
    second_scale = 1.0 if first == second else scale[second]
    rest = np.sqrt(max(misfit, 0.0) / count)
    return depth, misfit / square, rest, first, second, scale[max(first, 0)], second_scale


@jit("f8[:,::1], f8[:,::1], f8[:], f8, f8[:,::1]", allocates=False)
def _predict_motion(before, now, motion, dt, sums):
    """Predict the features' motion since the previous image, and add it to `sums`.

    Args:
        before, now: (k, 10) features of the previous and of the present image, see `feature_rows`.
        motion: (6,) camera motion between the two images.
        dt: time between the two images, s.
        sums: (k, 7) motion of each feature due to each direction of the camera, in units of the
            tolerance, and (last column) due to the target; modified in place.

    Returns:
        The largest predicted motion of a feature in this row, in units of the tolerance; the
        largest change of the predicted motion due to the difference of the two L, in units of the
        tolerance, infinite if an angle wrapped.
    """
    widest, greatest, interaction_change = 0.0, 0.0, 0.0
    for i in range(len(now)):
        if now[i, IS_ANGLE] > 0.0:
            widest = max(widest, now[i, TOLERANCE])
    for i in range(len(now)):
        predicted, changed, tolerance = 0.0, 0.0, now[i, TOLERANCE]
        for j in range(6):
            L_before, L = before[i, FIRST_L + j], now[i, FIRST_L + j]
            sums[i, j] += 0.5 * (L_before + L) * motion[j] / tolerance
            predicted += sums[i, j]
            changed += (L - L_before) * motion[j] / tolerance
        interaction_change = max(interaction_change, abs(changed))
        greatest = max(greatest, abs(predicted))
        moved = abs(now[i, ERROR] - before[i, ERROR]) / tolerance
        if now[i, IS_ANGLE] > 0.0 and moved > 1.0 / widest:
            interaction_change = np.inf
        sums[i, 6] += 0.5 * (before[i, DRIFT] + now[i, DRIFT]) * dt
    return greatest, interaction_change


@jit("f8[:,::1], f8[:,::1], f8, f8[:,::1], f8[:,:], f8[:,::1], f8[:,::1]", allocates=False)
def _finish_row(start, now, weight, row, last_row, products, next_products):
    """Complete a row of the fit, and add its products with itself and with the row before it.

    Args:
        start, now: (k, 10) features at the start and at the end of the row, see `feature_rows`.
        weight: weight of the row.
        row: (k, 7) sums of `_predict_motion`; becomes the row of the fit, see `CameraModelCheck`.
        last_row: (k, 7) row before it; its products are added if it has as many features.
        products, next_products: (7, 7) sums of the products; modified in place.
    """
    for i in range(len(row)):
        moved = now[i, ERROR] - start[i, ERROR] - row[i, 6]
        row[i, 6] = moved / now[i, TOLERANCE]
        for j in range(7):
            row[i, j] *= weight
    for i in range(len(row)):
        for j in range(7):
            for k in range(7):
                products[j, k] += row[i, j] * row[i, k]
                if len(last_row) == len(row):
                    next_products[j, k] += last_row[i, j] * row[i, k]


@jit("f8[:], f8[:], f8[:], f8[:], f8, f8, f8[:,:], f8[:,::1]", allocates=False)
def _compute_unexplained(q_before, v_before, q, v, dt, late, jacobian, features):
    """Return the largest feature motion that the joint speeds do not explain.

    A joint may move differently between two images than its speeds at these images predict. The
    result is in units of the tolerance.

    Args:
        q_before, q: (n,) joint positions at two images.
        v_before, v: (n,) joint speeds at the same two images.
        dt: time between the two images, s.
        late: fraction of dt in which a joint may still move at its previous speed.
        jacobian: (6, n) Jacobian of the arm.
        features: (k, 10) features of the later image, see `feature_rows`.
    """
    greatest = 0.0
    for j in range(len(q)):
        change = v[j] - v_before[j]
        expected = (v_before[j] + 0.5 * change) * dt
        unexplained = abs(q[j] - q_before[j] - expected) + late * dt * abs(change)
        for i in range(len(features)):
            moved = 0.0
            for k in range(6):
                moved += features[i, FIRST_L + k] * (jacobian[k, j] * unexplained)
            greatest = max(greatest, abs(moved / features[i, TOLERANCE]))
    return greatest
