"""Check of the motion of features and target from one image to the next."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np

from aras_visual_servo_base.compiled import jit
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.moments import Moments

from ..goals.goal import Goal
from ..observation.observation import Observation
from ..schemes.base import SchemeOutput


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
    """Check of the changes of features and visible area from image to image.

    The changes (steps) are compared with the prediction by the camera's motion.

    Attributes:
        jumps: jumps of the error within the last JUMP_WINDOW seconds.
        first_jump: first jump of the run; None if there was none.
        unchanged_since: time since which the error has been constant although the camera's motion
            should have changed it by MIN_PREDICTED_MOTION tolerances, s; None while the error
            changes.
        occluded_since: time at which a part of the target inside the image became invisible, s;
            None if no part is hidden.
        has_drift: whether the features have moved steadily while the camera was at rest.
        names: (k,) names of the features.
        next_region: ranges of x and y, normalised, in which the target may be in the next image;
            None if the target has not been visible.
        typical_step: usual size of the unexplained steps, in units of the tolerance.
    """

    # The error jumps repeatedly if it has jumped FREQUENT_JUMPS times within JUMP_WINDOW seconds.
    JUMP_WINDOW, FREQUENT_JUMPS = 2.0, 4
    # A step of the error between two images is a jump if it exceeds MIN_JUMP tolerances and
    # JUMP_FACTOR times the larger of two values: the typical step, and the step that the camera's
    # motion explains.
    MIN_JUMP, JUMP_FACTOR = 20.0, 8.0
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
    # Smallest motion between two images that is a jump of the target's centre, normalised.
    MIN_CENTRE_JUMP = 0.02
    # Something covers the target if at least this fraction of its area disappears between two
    # images and stays invisible for RECENT_IMAGES images. The area is corrected for the distance,
    # which follows from kinematics.
    MIN_HIDDEN_PART = 0.06
    # The areas of the target in two images are compared only if the squared distance between camera
    # and target changes by less than this fraction between the images.
    MAX_DISTANCE_CHANGE = 0.2
    # An occlusion is not searched for if the target's predicted area, relative to the area at the
    # goal, is below this. The camera is then more than 100 times as far from the target as at the
    # goal.
    MIN_PREDICTED_AREA = 1e-4

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
        self.occluded_since: float | None = None
        self.names: tuple[str, ...] = ()
        self._last_measurement: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self.typical_step, self._count = 1.0, 0
        self._same_count, self._same_stamp, self._path = 0, 0.0, 0.0
        # Sums over the images since the camera came to rest: number of images, squared steps of the
        # features, and steps (k,), in units of the tolerance.
        self._rest_sums: tuple[int, float, np.ndarray | float] = 0, 0.0, 0.0
        self.has_drift = False
        self._steps: deque[tuple[float, float, float]] = deque(maxlen=self.RECENT_IMAGES)
        # Predicted squared distance of the camera from the target in the last image, relative to
        # that at the goal.
        self._scale = 1.0
        # Area of the target in the last image relative to the goal's, after the effect of the
        # distance has been removed.
        self._last_area = 0.0
        # Running mean of such areas, and their typical relative deviation from the mean.
        self._mean_area = self._area_deviation = 0.0
        # Number of images since a part of the target disappeared, and the stamp (s) of the first of
        # these images.
        self._hidden_count, self._hidden_stamp = 0, 0.0
        self._whole_area = 0.0  # target's corrected area before a part disappeared
        self.next_region: tuple[tuple[float, float], tuple[float, float]] | None = None
        self._centre: tuple[float, float] | None = None
        self._centre_jumps = 0
        # Sums over all complete rows, (3, k): measured times predicted motion, squared measured
        # motion, squared predicted motion. The incomplete row, (2, k), contains the measured and
        # predicted motion so far.
        self._correlation_sums: np.ndarray | None = None
        self._row = np.zeros((2, 0))

    def interrupt(self) -> None:
        """Forget the previous image, because the image after it had no measurement."""
        self._last_measurement = None

    @property
    def target_motion_part(self) -> float:
        """Return the fraction of the features' latest motion that is the target's own, 0 to 1.

        The last RECENT_IMAGES images are evaluated.
        """
        if not self._steps:
            return 0.0
        whole = rest = predicted = 0.0
        for step in self._steps:
            whole, rest, predicted = whole + step[0], rest + step[1], predicted + step[2]
        # A smaller motion of the features may also be due to a wrong mounting of the camera, so it
        # is not attributed to the target.
        return rest / whole if whole > max(self.MIN_JUMP, self.JUMP_FACTOR * predicted) else 0.0

    @property
    def has_frequent_jumps(self) -> bool:
        """Return whether the features jump repeatedly while the target's centre does not."""
        jumps = self.jumps
        is_frequent = (
            len(jumps) == self.FREQUENT_JUMPS
            and jumps[-1].stamp - jumps[0].stamp < self.JUMP_WINDOW
        )
        return is_frequent and self._centre_jumps < self.FREQUENT_JUMPS // 2

    def is_jumping(self, stamp: float) -> bool:
        """Return whether the features have jumped repeatedly shortly before `stamp` (s)."""
        return self.has_frequent_jumps and stamp - self.jumps[-1].stamp < self.JUMP_WINDOW

    @property
    def feature_correlations(self) -> np.ndarray | None:
        """Return the correlation (k,) of measured with predicted motion of each feature, -1 to 1.

        The correlation of a feature with too little predicted motion is 0. Return None if there are
        no data.
        """
        if self._correlation_sums is None:
            return None
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
        return (
            self._correlation_sums is not None
            and self._correlation_sums[2].sum() >= self.MIN_ROWS * self._min_row**2
        )

    @property
    def motion_ratio(self) -> float:
        """Return the ratio of measured to predicted motion of the features; 1 without data."""
        if self._correlation_sums is None:
            return 1.0
        _, moved, predicted = self._correlation_sums.sum(axis=1)
        return float(np.sqrt(moved / max(predicted, 1.0)))

    def add(
        self,
        scheme_output: SchemeOutput,
        observation: Observation,
        tolerances: np.ndarray,
        is_angle: np.ndarray,
    ) -> None:
        """Add one image.

        Args:
            scheme_output: measurement of the image.
            observation: observation of the image.
            tolerances: (k,) tolerance of each component of the error.
            is_angle: (k,) whether each component is an angle, which may wrap.
        """
        L, error = scheme_output.L, np.asarray(scheme_output.error, float)
        before, self._last_measurement = self._last_measurement, None
        if L is None or L.shape != (len(error), 6):
            return
        now = error, np.asarray(L, float), np.array(scheme_output.error_drift, float, ndmin=1)
        self._last_measurement, self.names = now, scheme_output.names
        if before is None or observation.motion is None or len(before[0]) != len(error):
            self._same_stamp, self._same_count, self._path = observation.stamp, 0, 0.0
            self._steps.clear()
            return
        sums = self._correlation_sums
        if sums is None or sums.shape[1] != len(error):
            sums, self._row = np.zeros((3, len(error))), np.zeros((2, len(error)))
            self._correlation_sums = sums
        largest, at, explained, moved, unexplained, path, wrapped = _compare_step(
            *before, *now, observation.motion, observation.dt, tolerances, is_angle, self._min_row,
            self._row, sums,
        )  # fmt: skip
        if wrapped:
            self._row[:] = 0.0
            return
        if path > self.MAX_REST_MOTION:
            self._rest_sums = 0, 0.0, 0.0
        elif self._rest_sums[0] < self.MAX_REST_IMAGES:
            self._add_rest_step(moved, (error - before[0]) / tolerances)
        self._steps.append((moved, unexplained, len(error) * path * path))
        self._count += 1
        if self._count <= self.RECENT_IMAGES:
            self.typical_step = max(self.typical_step, largest)
        elif largest > max(self.MIN_JUMP, self.JUMP_FACTOR * max(self.typical_step, explained)):
            change = abs(error[at] - before[0][at])
            jump = Jump(
                observation.stamp, scheme_output.names[at], change, explained * tolerances[at]
            )
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
        is_steady = length**2 > self.MIN_DRIFT_PART * images * square
        self.has_drift = (
            self.has_drift
            or is_steady
            and images >= self.MIN_REST_IMAGES
            and length > self.MIN_DRIFT
        )

    def add_area(self, observation: Observation, goal: Goal) -> None:
        """Update the visible area of the target; detect occlusions and jumps of the centre."""
        moments, desired = observation.moments, goal.moments
        if not observation.valid or moments is None or desired is None or moments.m00 <= 0.0:
            return
        x, y = moments.xg, moments.yg
        dx, dy = (0.0, 0.0) if self._centre is None else (x - self._centre[0], y - self._centre[1])
        self._centre = x, y
        jumped = max(abs(dx), abs(dy)) > self.MIN_CENTRE_JUMP
        # The target's centre is extrapolated by twice its last displacement. In the next image, the
        # target should be within one target size of this point.
        x, y, size = x + 2.0 * dx, y + 2.0 * dy, sqrt(moments.m00)
        self.next_region = (x - size, x + size), (y - size, y + size)
        self._centre_jumps = min(self._centre_jumps + 1, self.FREQUENT_JUMPS) if jumped else max(
            self._centre_jumps - 1, 0)
        predicted = predict_area(observation, goal)
        if predicted < self.MIN_PREDICTED_AREA:
            return
        scale = 1.0 / predicted
        area, scale_change = moments.m00 / desired.m00 * scale, abs(scale / self._scale - 1.0)
        last, self._last_area, self._scale = self._last_area or area, area, scale
        before = self._mean_area or area
        if (
            observation.touched_borders
            or moments.kind != desired.kind
            or scale_change > self.MAX_DISTANCE_CHANGE
        ):
            return
        change = abs(area / before - 1.0)
        if self._hidden_count:
            if area > (1.0 - 0.5 * self.MIN_HIDDEN_PART) * self._whole_area:
                self._hidden_count, self.occluded_since = 0, None
                return
            self._hidden_count += 1
            if self._hidden_count == self.RECENT_IMAGES:
                self.occluded_since = self._hidden_stamp
        elif max(area / before, area / last) < 1.0 - max(
            self.MIN_HIDDEN_PART, self.JUMP_FACTOR * self._area_deviation
        ):
            self._hidden_count, self._hidden_stamp, self._whole_area = 1, observation.stamp, before
        else:
            self._area_deviation = (
                self.STEP_MEMORY * self._area_deviation + (1.0 - self.STEP_MEMORY) * change
            )
            self._mean_area = self.STEP_MEMORY * before + (1.0 - self.STEP_MEMORY) * area

    @property
    def visible_part(self) -> float:
        """Return the fraction of a covered target that is still visible, 0 to 1."""
        return self._last_area / self._whole_area if self._whole_area else 1.0


def predict_area(observation: Observation, goal: Goal) -> float:
    """Return the area that the target should have in this view, relative to the goal.

    The image area of a small patch at depth Z, in a plane at the distance d from the camera, is d /
    Z^3 times the area of the patch. Both d and Z follow from the estimated plane. Without a plane,
    the area is assumed to be inversely proportional to the squared distance.
    """
    measured, desired, plane = observation.moments, goal.moments, observation.plane
    if plane is None or goal.plane is None:
        return predict_distance(observation.world_T_camera, goal) ** -2
    here, there = _compute_patch_area(plane, measured), _compute_patch_area(goal.plane, desired)
    return max(here / there, 1e-9)


def _compute_patch_area(plane: Plane, moments: Moments) -> float:
    """Return d / Z^3 of a plane at the target's centre; see `predict_area`."""
    A, B, C = plane
    return max(A * moments.xg + B * moments.yg + C, 1e-9) ** 3 / hypot(A, B, C)


def predict_distance(world_T_camera: np.ndarray | None, goal: Goal) -> float:
    """Return the target's depth that follows from the joints, relative to the goal's depth.

    Return 1 if the goal has no pose.
    """
    if world_T_camera is None or goal.world_T_camera is None:
        return 1.0
    goal_pose = goal.world_T_camera
    target = goal_pose[:3, 3] + goal.distance * goal_pose[:3, 2]
    depth = float(world_T_camera[:3, 2] @ (target - world_T_camera[:3, 3]))
    return max(depth / goal.distance, 1e-3)


@jit("f8[:], f8[:,:], f8[:], f8[:], f8[:,:], f8[:], f8[:], f8, f8[:], b1[:], f8, f8[:,::1], "
          "f8[:,::1]", allocates=False)
def _compare_step(
    error_before,
    L_before,
    error_drift_before,
    error,
    L,
    error_drift,
    motion,
    dt,
    tolerances,
    is_angle,
    min_row,
    row,
    sums,
):
    """Compare one step of the features with the camera's motion.

    Args:
        error_before, error: (k,) error at the previous and at the present image.
        L_before, L: (k, 6) interaction matrix at each of the two images.
        error_drift_before, error_drift: (k,) or (1,) rate of each error component due to the
            target's motion, per s.
        motion: (6,) motion of the camera between the two images.
        dt: time between the two images, s.
        tolerances: (k,) tolerance of each component of the error.
        is_angle: (k,) whether each component is an angle, which may wrap.
        min_row: predicted motion, in units of the tolerance, at which a row (a sum over successive
            steps) is complete.
        row: (2, k) measured and predicted motion of the incomplete row; modified in place.
        sums: (3, k) sums over complete rows of measured times predicted motion, measured motion
            squared, predicted motion squared; modified in place.

    Returns:
        The largest unexplained step, in units of the tolerance; the index of its feature; the
        explained step of this feature; the sums of the squares of all steps and of the unexplained
        steps, in units of the tolerance; the largest predicted step; whether an angle wrapped.
    """
    largest, at, explained, square, unexplained, path, longest = -1.0, 0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(error)):
        if is_angle[i] and abs(error[i] - error_before[i]) > 1.0:
            return 0.0, 0, 0.0, 0.0, 0.0, 0.0, True
    for i in range(len(error)):
        predicted = 0.0
        for j in range(6):
            predicted += 0.5 * (L_before[i, j] + L[i, j]) * motion[j]
        drift_sum = (
            error_drift_before[min(i, len(error_drift_before) - 1)]
            + error_drift[min(i, len(error_drift) - 1)]
        )
        predicted = (predicted + 0.5 * drift_sum * dt) / tolerances[i]
        moved = (error[i] - error_before[i]) / tolerances[i]
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
        for i in range(len(error)):
            moved, predicted = row[0, i], row[1, i]
            sums[0, i] += moved * predicted
            sums[1, i] += moved * moved
            sums[2, i] += predicted * predicted
            row[0, i] = row[1, i] = 0.0
    return largest, at, explained, square, unexplained, path, False
