"""How features and target move from one image to the next, compared with L and the camera."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np

from aras_visual_servo_base.compiled import jit

from ..goals.goal import Goal
from ..observation.observation import Observation
from ..schemes.base import SchemeOutput


@dataclass(frozen=True)
class Jump:
    """A change of the error between two images that the camera's motion does not explain.

    stamp: of the later image, s. feature: its name. size, explained: of the change, and of it by L
    and the camera's motion, in the feature's unit.
    """

    stamp: float
    feature: str
    size: float
    explained: float

    def __str__(self) -> str:
        return (
            f"{self.feature} jumps by {self.size:.2g} at {self.stamp:.2f} s, where L and the "
            f"camera's motion explain {self.explained:.2g}"
        )


class StepCheck:
    """Follows the steps of features and of the visible area from image to image.

    Attributes:
        jumps: of the error, the latest in the last LATELY s.
        first_jump: of the run; None: there was none.
        unchanged: since when the error has been the same to the last bit though the camera has
            moved it by MOVED tolerances or more, s; None: it changes.
        covered: since when a part of the target has been invisible that does not lie beyond the
            image's border, s; None: it is as visible as at the first image.
        drifts: whether the features have moved on steadily while the camera was at rest.
        names: (k,) of the features.
        next: ranges of x and y, normalised, in which the target may be in the next image; None: it
            has not been visible.
        usual: tolerances of a step that are not explained in general.
    """

    # s, and jumps within that, from which on features jump again and again
    JUMP_WINDOW, FREQUENT_JUMPS = 2.0, 4
    # A jump is of so many tolerances, and so many times what L explains and what is not explained
    # in general.
    MIN_JUMP, JUMP_FACTOR = 20.0, 8.0
    STEP_MEMORY = 0.9  # part of what was not explained in general that stays so from image to image
    MIN_PREDICTED_MOTION, UNCHANGED_IMAGES = 5.0, 8  # tolerances; images
    # Tolerances by which the camera has to move a feature for its motion to be compared, of which
    # noise is a small part; and rows of that size from which on something is known.
    MIN_ROW, MIN_ROWS = 8.0, 5
    RECENT_IMAGES = 5
    # Tolerances by which the camera's motion may move features before a camera at rest, and by
    # which they drift there at least; part of the squares that a steady drift has (noise has 1/n);
    # images, at least, and for how many of a rest this is looked at.
    MAX_REST_MOTION, MIN_DRIFT, MIN_DRIFT_PART, MIN_REST_IMAGES, MAX_REST_IMAGES = (
        0.05,
        2.5,
        0.7,
        4,
        30,
    )
    MIN_CENTRE_JUMP = 0.02  # normalised, by which the target's own centre jumps, at least
    # Part of the area, with the distance by kinematics taken off, that disappears between two
    # images where something is laid over a target, at least, and for FEW images.
    MIN_HIDDEN_PART = 0.06
    MAX_DISTANCE_CHANGE = 0.2  # part of its square by which the distance may change between these

    def __init__(self, min_row: float = MIN_ROW) -> None:
        """`row`: tolerances of a row whose motion is compared, see ROW."""
        self._min_row = min_row
        self.jumps: deque[Jump] = deque(maxlen=self.FREQUENT_JUMPS)
        self.first_jump: Jump | None = None
        self.unchanged_since: float | None = None
        self.occluded_since: float | None = None
        self.names: tuple[str, ...] = ()
        self._last_measurement: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self.typical_step, self._count = 1.0, 0
        self._same_count, self._same_stamp, self._path = 0, 0.0, 0.0
        # Of images before a camera at rest: their number, the sum of the steps' squares and that of
        # the steps (k,), in tolerances.
        self._rest_sums: tuple[int, float, np.ndarray | float] = 0, 0.0, 0.0
        self.has_drift = False
        self._steps: deque[tuple[float, float, float]] = deque(maxlen=self.RECENT_IMAGES)
        self._scale = 1.0  # square of the distance by kinematics at the last image
        self._last_area = 0.0  # of the last image at the goal's distance, in that of the goal
        # Its mean, and the part by which it differs from that in general.
        self._mean_area = self._area_deviation = 0.0
        # images since a part disappeared, and when, s
        self._hidden_count, self._hidden_stamp = 0, 0.0
        self._whole_area = 0.0  # the same of the last image before something covered the target
        self.next_region: tuple[tuple[float, float], tuple[float, float]] | None = None
        self._centre: tuple[float, float] | None = None
        self._centre_jumps = 0
        # (3, k) of whole rows: moved times predicted, and both squared; (2, k) moved and predicted
        # of the row that is not yet whole.
        self._correlation_sums: np.ndarray | None = None
        self._row = np.zeros((2, 0))

    def interrupt(self) -> None:
        """An image without measurement: the next one has no predecessor."""
        self._last_measurement = None

    @property
    def target_motion_part(self) -> float:
        """Part of the features' motion in the last FEW images that is not the camera's, 0 to 1."""
        if not self._steps:
            return 0.0
        whole, rest, predicted = (sum(part) for part in zip(*self._steps, strict=True))
        # Beyond what the camera could have done, however it is mounted.
        return rest / whole if whole > max(self.MIN_JUMP, self.JUMP_FACTOR * predicted) else 0.0

    @property
    def has_frequent_jumps(self) -> bool:
        """Whether the features jump again and again, and the target does not."""
        jumps = self.jumps
        often = (
            len(jumps) == self.FREQUENT_JUMPS
            and jumps[-1].stamp - jumps[0].stamp < self.JUMP_WINDOW
        )
        return often and self._centre_jumps < self.FREQUENT_JUMPS // 2

    def is_jumping(self, stamp: float) -> bool:
        """Whether they have done so until now."""
        return self.has_frequent_jumps and stamp - self.jumps[-1].stamp < self.JUMP_WINDOW

    @property
    def feature_correlations(self) -> np.ndarray | None:
        """(k,) correlation of each feature's motion with what L says of it, -1 to 1; 0 where it has
        not moved far. None: nothing is known."""
        if self._correlation_sums is None:
            return None
        product, moved, predicted = self._correlation_sums
        size = np.sqrt(moved * predicted)
        known = (predicted > self.MIN_ROWS * self._min_row**2) & (moved > 0.0)
        return np.divide(product, size, out=np.zeros(len(size)), where=known)

    @property
    def correlation(self) -> float:
        """Correlation of all features' motion with what L and the camera say of it, -1 to 1; 1
        where they have not moved far."""
        if not self.has_enough_motion:
            return 1.0
        product, moved, predicted = self._correlation_sums.sum(axis=1)
        if moved == 0.0:
            return 0.0
        return float(product / np.sqrt(moved * predicted))

    @property
    def has_enough_motion(self) -> bool:
        """Whether the camera has moved the features far enough to say how they go together."""
        return (
            self._correlation_sums is not None
            and self._correlation_sums[2].sum() >= self.MIN_ROWS * self._min_row**2
        )

    @property
    def motion_ratio(self) -> float:
        """Times as far as L and the camera say that the features have moved in all."""
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
        """Take in one image; angles: (k,) bool, of components that may wrap."""
        L, error = scheme_output.L, np.asarray(scheme_output.error, float)
        before, self._last_measurement = self._last_measurement, None
        if L is None or np.shape(L) != (len(error), 6):
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
        most, at, explained, moved, left, path, wrapped = _compare_step(
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
        self._steps.append((moved, left, len(error) * path * path))
        self._count += 1
        if self._count <= self.RECENT_IMAGES:
            self.typical_step = max(self.typical_step, most)
        elif most > max(self.MIN_JUMP, self.JUMP_FACTOR * max(self.typical_step, explained)):
            change = abs(error[at] - before[0][at])
            jump = Jump(
                observation.stamp, scheme_output.names[at], change, explained * tolerances[at]
            )
            self.jumps.append(jump)
            self.first_jump = self.first_jump or jump
        else:
            self.typical_step = (
                self.STEP_MEMORY * self.typical_step + (1.0 - self.STEP_MEMORY) * most
            )
        if moved != 0.0:
            self._same_count, self._path, self._same_stamp = 0, 0.0, observation.stamp
            self.unchanged_since = None
            return
        self._same_count, self._path = self._same_count + 1, self._path + path
        if self._same_count >= self.UNCHANGED_IMAGES and self._path > self.MIN_PREDICTED_MOTION:
            self.unchanged_since = self._same_stamp

    def _add_rest_step(self, moved: float, step: np.ndarray) -> None:
        """Sum up the steps (k,), in tolerances, of features before a camera at rest; moved: square
        of the step."""
        images, square, sums = self._rest_sums
        images, square, sums = self._rest_sums = images + 1, square + moved, sums + step
        length = float(np.linalg.norm(sums))
        steady = length**2 > self.MIN_DRIFT_PART * images * square
        self.has_drift = (
            self.has_drift or steady and images >= self.MIN_REST_IMAGES and length > self.MIN_DRIFT
        )

    def add_area(self, observation: Observation, goal: Goal) -> None:
        """Note what is visible of the target in an image, and whether its centre jumps."""
        seen, desired = observation.moments, goal.moments
        if not observation.valid or seen is None or desired is None or seen.m00 <= 0.0:
            return
        x, y = seen.xg, seen.yg
        dx, dy = (0.0, 0.0) if self._centre is None else (x - self._centre[0], y - self._centre[1])
        self._centre = x, y
        jumped = max(abs(dx), abs(dy)) > self.MIN_CENTRE_JUMP
        # Twice as far on, by the target's size more: where it may be in the next image.
        x, y, size = x + 2.0 * dx, y + 2.0 * dy, sqrt(seen.m00)
        self.next_region = (x - size, x + size), (y - size, y + size)
        self._centre_jumps = min(self._centre_jumps + 1, self.FREQUENT_JUMPS) if jumped else max(
            self._centre_jumps - 1, 0)
        scale = 1.0 / predict_area(observation, goal)
        area, nearer = seen.m00 / desired.m00 * scale, abs(scale / self._scale - 1.0)
        last, self._last_area, self._scale = self._last_area or area, area, scale
        before = self._mean_area or area
        if (
            observation.touched_borders
            or seen.kind != desired.kind
            or nearer > self.MAX_DISTANCE_CHANGE
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
        """Part of the target that is visible since something covers it, 0 to 1."""
        return self._last_area / self._whole_area if self._whole_area else 1.0


def predict_area(observation: Observation, goal: Goal) -> float:
    """Return the area that the target has in this view, in that of the goal, by its believed plane.

    A small part of a plane n P = d has an image of area d / Z^3 in that of its own; 1 / Z and n / d
    are those of the plane. Without a plane it is the square of the distance that counts.
    """
    seen, desired, plane = observation.moments, goal.moments, observation.plane
    if plane is None or goal.plane is None:
        return predict_distance(observation.world_T_camera, goal) ** -2
    here, there = (
        max(one.inverse_depth(moments.xg, moments.yg), 1e-9) ** 3 / hypot(one.A, one.B, one.C)
        for one, moments in ((plane, seen), (goal.plane, desired))
    )
    return max(here / there, 1e-9)


def predict_distance(world_T_camera: np.ndarray | None, goal: Goal) -> float:
    """The target's depth before the camera, in that at the goal, by the joints alone; 1 where the
    goal has no pose."""
    if world_T_camera is None or goal.world_T_camera is None:
        return 1.0
    there = goal.world_T_camera
    target = there[:3, 3] + goal.distance * there[:3, 2]
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
        error_before, error: (k,); L_before, L: (k, 6); rate_before, rate: (k,) or (1,).
        motion: (6,) of the camera between them; dt: s. tolerances: (k,). angles: (k,) may wrap.
        least: tolerances by which a row is predicted to move a feature, at least.
        row: (2, k) moved and predicted since the last whole row; added to.
        sums: (3, k) of moved times predicted, moved squared, predicted squared, of whole rows;
            added to.

    Returns:
        Most that is not explained, in tolerances; the feature; what L explains of its step; the
        squares of all steps, and of what is not explained, in tolerances; the longest predicted
        step; whether an angle wrapped.
    """
    most, at, explained, square, left, path, longest = -1.0, 0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(error)):
        if is_angle[i] and abs(error[i] - error_before[i]) > 1.0:
            return 0.0, 0, 0.0, 0.0, 0.0, 0.0, True
    for i in range(len(error)):
        predicted = 0.0
        for j in range(6):
            predicted += 0.5 * (L_before[i, j] + L[i, j]) * motion[j]
        own = (
            error_drift_before[min(i, len(error_drift_before) - 1)]
            + error_drift[min(i, len(error_drift) - 1)]
        )
        predicted = (predicted + 0.5 * own * dt) / tolerances[i]
        moved = (error[i] - error_before[i]) / tolerances[i]
        rest = abs(moved - predicted)
        if rest > most:
            most, at, explained = rest, i, abs(predicted)
        square += moved * moved
        left += (moved - predicted) ** 2
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
    return most, at, explained, square, left, path, False
