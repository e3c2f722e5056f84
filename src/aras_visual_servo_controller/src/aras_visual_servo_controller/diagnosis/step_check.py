"""Check of the motion of the features from one image to the next."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import sqrt

import numpy as np

from aras_visual_servo_base.compiled import jit

from ..observation.observation import Observation
from .feature_rows import DRIFT, ERROR, FIRST_L, IS_ANGLE, TOLERANCE, FeatureHistory

# A step of the error between two images is a jump if it exceeds MIN_JUMP tolerances and JUMP_FACTOR
# times the larger of two values: the typical step, and the step that the camera's motion explains.
MIN_JUMP, JUMP_FACTOR = 20.0, 8.0


@dataclass(frozen=True)
class Jump:
    """A change of the error between two images that the camera's motion does not explain.

    Attributes:
        stamp: stamp of the later image, s.
        feature: name of the feature.
        size: size of the change, in the feature's unit.
        explained: change that L and the camera's motion explain, in the feature's unit.
    """

    stamp: float
    feature: str
    size: float
    explained: float

    def __str__(self) -> str:
        return (
            f"{self.feature} jumps by {self.size:.2g} at {self.stamp:.2f} s, but L and the "
            f"camera's motion explain only {self.explained:.2g}"
        )


class StepCheck:
    """Check of the changes of the features from image to image.

    The changes (steps) are compared with the prediction by the camera's motion.

    Attributes:
        jumps: jumps of the error within the last JUMP_WINDOW seconds.
        first_jump: first jump of the run; None if there was none.
        unchanged_since: time since which the error has been constant although the camera's motion
            should have changed it by MIN_PREDICTED_MOTION tolerances, s; None while the error
            changes.
        has_drift: whether the features have moved steadily while the camera was at rest.
        target_motion_part: fraction of the features' motion in the last RECENT_IMAGES images that
            is the target's own, 0 to 1.
        names: (k,) names of the features.
        typical_step: usual size of the unexplained steps, in units of the tolerance.
    """

    # The error jumps repeatedly if it has jumped FREQUENT_JUMPS times within JUMP_WINDOW seconds.
    JUMP_WINDOW, FREQUENT_JUMPS = 2.0, 4
    STEP_MEMORY = 0.9  # weight of the old value in the running means of the steps
    # `unchanged_since` is set if the error has not changed in UNCHANGED_IMAGES images although the
    # features should have moved by MIN_PREDICTED_MOTION tolerances.
    MIN_PREDICTED_MOTION, UNCHANGED_IMAGES = 5.0, 8
    # The steps of successive images are added up until their predicted motion is at least this
    # large, in units of the tolerance; then noise is a small part of the sum. The sums of measured
    # and of predicted steps are together called a row.
    MIN_ROW = 8.0
    # Smallest number of sums from which the correlation of measured and predicted motion is
    # computed.
    MIN_ROWS = 5
    RECENT_IMAGES = 5
    # The features drift although the camera is at rest if their motion exceeds MIN_DRIFT
    # tolerances, and if a steady drift explains more than MIN_DRIFT_PART of the squared steps.
    # For noise in n images, this part is only about 1/n.
    MIN_DRIFT, MIN_DRIFT_PART = 2.5, 0.7
    # A camera is at rest if its motion should move no feature by more than this many tolerances.
    MAX_REST_MOTION = 0.05
    # Smallest and largest number of images in which a drift of the features is searched for while
    # the camera is at rest.
    MIN_REST_IMAGES, MAX_REST_IMAGES = 4, 30

    def __init__(self, min_row: float = MIN_ROW) -> None:
        """Create the check.

        Args:
            min_row: predicted motion over which measured and predicted motion are summed before
                they are compared, in units of the tolerance; see MIN_ROW.
        """
        self._min_row = min_row
        self.jumps: deque[Jump] = deque(maxlen=self.FREQUENT_JUMPS)
        self.first_jump: Jump | None = None
        self.unchanged_since: float | None = None
        self.names: tuple[str, ...] = ()
        self.typical_step, self._count = 1.0, 0
        self._same_count, self._same_stamp, self._path = 0, 0.0, 0.0
        # Sums over the images since the camera came to rest: number of images, squared steps of the
        # features, and steps (k,), in units of the tolerance.
        self._rest_sums: tuple[int, float, np.ndarray | float] = 0, 0.0, 0.0
        self.has_drift = False
        # Squared steps of all features in the last images, the newest last: measured, unexplained
        # and predicted steps.
        self._steps, self.target_motion_part = np.zeros((self.RECENT_IMAGES, 3)), 0.0
        # Sums over all complete rows, (3, k): measured times predicted motion, squared measured
        # motion, squared predicted motion. The incomplete row, (2, k), contains the measured and
        # predicted motion so far.
        self._correlation_sums, self._row = np.zeros((3, 0)), np.zeros((2, 0))

    @property
    def has_frequent_jumps(self) -> bool:
        """Return whether the features have jumped repeatedly."""
        jumps = self.jumps
        return (
            len(jumps) == self.FREQUENT_JUMPS
            and jumps[-1].stamp - jumps[0].stamp < self.JUMP_WINDOW
        )

    def is_jumping(self, stamp: float) -> bool:
        """Return whether the features have jumped repeatedly shortly before `stamp` (s)."""
        return self.has_frequent_jumps and stamp - self.jumps[-1].stamp < self.JUMP_WINDOW

    @property
    def feature_correlations(self) -> np.ndarray:
        """Return the correlation (k,) of measured with predicted motion of each feature, -1 to 1.

        The correlation of a feature with too little predicted motion is 0.
        """
        product, moved, predicted = self._correlation_sums
        size = np.sqrt(moved * predicted)
        known = (predicted > self.MIN_ROWS * self._min_row**2) & (moved > 0.0)
        return np.divide(product, size, out=np.zeros(len(size)), where=known)

    @property
    def correlation(self) -> float:
        """Return the correlation of measured with predicted motion of all features, -1 to 1.

        Return 1 if the predicted motion is too small.
        """
        if not self.has_enough_motion:
            return 1.0
        product, moved, predicted = self._correlation_sums.sum(axis=1)
        if moved == 0.0:
            return 0.0
        return float(product / np.sqrt(moved * predicted))

    @property
    def has_enough_motion(self) -> bool:
        """Return whether the camera has moved far enough to compare measured with predicted motion.
        """
        return bool(self._correlation_sums[2].sum() >= self.MIN_ROWS * self._min_row**2)

    @property
    def motion_ratio(self) -> float:
        """Return the ratio of measured to predicted motion of the features."""
        _, moved, predicted = self._correlation_sums.sum(axis=1)
        return float(np.sqrt(moved / max(predicted, 1.0)))

    def add(
        self, features: FeatureHistory, names: tuple[str, ...], observation: Observation
    ) -> None:
        """Add one image.

        Args:
            features: features of the image and of the one before it.
            names: (k,) names of the features.
            observation: observation of the image.
        """
        before, now = features.before, features.now
        if now is None:
            return
        if before is None:
            self._same_stamp, self._same_count, self._path = observation.stamp, 0, 0.0
            self._steps[:], self.target_motion_part = 0.0, 0.0
            return
        self.names = names
        count = now.shape[0]
        if self._row.shape[1] != count:
            self._correlation_sums, self._row = np.zeros((3, count)), np.zeros((2, count))
            self._rest_sums = 0, 0.0, 0.0
        largest, at, explained, moved, path, part = _compare_step(
            before, now, observation.motion, observation.dt, self._min_row, self._row,
            self._correlation_sums, self._steps,
        )  # fmt: skip
        if at < 0:  # an angle has wrapped
            self._row[:] = 0.0
            return
        self.target_motion_part = part
        if path > self.MAX_REST_MOTION:
            self._rest_sums = 0, 0.0, 0.0
        elif not self.has_drift and self._rest_sums[0] < self.MAX_REST_IMAGES:
            self._add_rest_step(moved, (now[:, ERROR] - before[:, ERROR]) / now[:, TOLERANCE])
        self._count += 1
        if self._count <= self.RECENT_IMAGES:
            self.typical_step = max(self.typical_step, largest)
        elif largest > MIN_JUMP and largest > JUMP_FACTOR * max(self.typical_step, explained):
            change = abs(now[at, ERROR] - before[at, ERROR])
            jump = Jump(observation.stamp, names[at], change, explained * now[at, TOLERANCE])
            self.jumps.append(jump)
            self.first_jump = self.first_jump or jump
        else:
            self.typical_step = (
                self.STEP_MEMORY * self.typical_step + (1.0 - self.STEP_MEMORY) * largest
            )
        if moved != 0.0:
            self._same_count, self._path, self._same_stamp = 0, 0.0, observation.stamp
            self.unchanged_since = None
            return
        self._same_count, self._path = self._same_count + 1, self._path + path
        if self._same_count >= self.UNCHANGED_IMAGES and self._path > self.MIN_PREDICTED_MOTION:
            self.unchanged_since = self._same_stamp

    def _add_rest_step(self, moved: float, step: np.ndarray) -> None:
        """Add the step of the features while the camera is at rest.

        Args:
            moved: squared length of the step.
            step: (k,) change of the features, in units of the tolerance.
        """
        images, square, sums = self._rest_sums
        images, square, sums = self._rest_sums = images + 1, square + moved, sums + step
        length = sqrt(float(sums @ sums))
        self.has_drift = (
            length**2 > self.MIN_DRIFT_PART * images * square
            and images >= self.MIN_REST_IMAGES
            and length > self.MIN_DRIFT
        )


@jit("f8[:,::1], f8[:,::1], f8[:], f8, f8, f8[:,::1], f8[:,::1], f8[:,::1]", allocates=False)
def _compare_step(before, now, motion, dt, min_row, row, sums, steps):
    """Compare one step of the features with the camera's motion.

    Args:
        before, now: (k, 10) features of the previous and of the present image, see `feature_rows`.
        motion: (6,) motion of the camera between the two images.
        dt: time between the two images, s.
        min_row: predicted motion, in units of the tolerance, at which a row (a sum over successive
            steps) is complete.
        row: (2, k) measured and predicted motion of the incomplete row; modified in place.
        sums: (3, k) sums over complete rows of measured times predicted motion, measured motion
            squared, predicted motion squared; modified in place.
        steps: (m, 3) squared steps of the last images, see `StepCheck`; modified in place.

    Returns:
        The largest unexplained step, in units of the tolerance; the index of its feature, -1 if an
        angle wrapped; the explained step of this feature; the sum of the squares of all steps, in
        units of the tolerance; the largest predicted step; the fraction of the features' motion in
        the last images that is the target's own.
    """
    largest, at, explained, square, unexplained, path, longest = -1.0, 0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(now)):
        if now[i, IS_ANGLE] > 0.0 and abs(now[i, ERROR] - before[i, ERROR]) > 1.0:
            return 0.0, -1, 0.0, 0.0, 0.0, 0.0
    for i in range(len(now)):
        predicted, tolerance = 0.0, now[i, TOLERANCE]
        for j in range(FIRST_L, FIRST_L + 6):
            predicted += 0.5 * (before[i, j] + now[i, j]) * motion[j - FIRST_L]
        drift_sum = before[i, DRIFT] + now[i, DRIFT]
        predicted = (predicted + 0.5 * drift_sum * dt) / tolerance
        moved = (now[i, ERROR] - before[i, ERROR]) / tolerance
        residual = abs(moved - predicted)
        if residual > largest:
            largest, at, explained = residual, i, abs(predicted)
        square += moved * moved
        unexplained += (moved - predicted) ** 2
        path = max(path, abs(predicted))
        row[0, i] += moved
        row[1, i] += predicted
        longest = max(longest, abs(row[1, i]))
    if longest >= min_row:
        for i in range(len(now)):
            moved, predicted = row[0, i], row[1, i]
            sums[0, i] += moved * predicted
            sums[1, i] += moved * moved
            sums[2, i] += predicted * predicted
            row[0, i] = row[1, i] = 0.0
    last, whole, rest, known = len(steps) - 1, 0.0, 0.0, 0.0
    for n in range(last):
        for j in range(3):
            steps[n, j] = steps[n + 1, j]
    steps[last, 0], steps[last, 1], steps[last, 2] = square, unexplained, len(now) * path * path
    for n in range(last + 1):
        whole, rest, known = whole + steps[n, 0], rest + steps[n, 1], known + steps[n, 2]
    # A smaller motion of the features may also be due to a wrong mounting of the camera, so it is
    # not attributed to the target.
    part = rest / whole if whole > max(MIN_JUMP, JUMP_FACTOR * known) else 0.0
    return largest, at, explained, square, path, part
