"""Check whether the images of an arrival show the same view of the target as the goal.

For every scheme, the target's position, size and shape are compared with those at the goal, in
addition to the scheme's own features. If the view differs only by a camera motion that the features
do not measure, this motion is not a fault: it adds to the uncertainty of the arrival.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from functools import cached_property
from math import log
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_camera import moment_feature_values as camera_features
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.interaction import Plane

from .vector_history import VectorHistory

if TYPE_CHECKING:
    from aras_visual_servo_camera.moments import Moments

    from ..goals.goal import Goal
    from ..observation.observation import Observation

MIN_VIEWS = 3  # smallest number of images that are compared with the goal
# a mean difference from the goal below this many standard deviations is noise
NOISE_DEVIATIONS = 3.0
MAX_WINDOW = 120  # largest number of images that are averaged
# Tolerances of the scale-free central moments. At the end of converged runs, second-order moments
# differ from the goal's by up to 0.2 %, third-order moments by up to 6e-5. At a wrong pose, rotated
# by 18 degrees, they differ by 0.6 % and 5e-4; only the third-order tolerance detects this pose.
SECOND_ORDER_TOLERANCE = 0.02  # relative to the goal's largest second-order moment
THIRD_ORDER_TOLERANCE = 2.5e-4
# Tolerance of the target's centre (normalised) and size (relative), in addition to the noise and to
# the accuracy of the features.
MAX_PLACE_DIFFERENCE = 4e-3
# A direction of camera motion is not measured if a motion of this size changes no feature by more
# than its tolerance. Translation as a fraction of the depth, rotation in rad.
UNSEEN_MOTION = 0.05
# Some camera motions change no feature. The target's position and size in the image reveal such a
# motion if they change (normalised) by at least this fraction of the motion (in target depths or
# rad).
MIN_SHOWN_PART = 0.05
SHAPE_NUMBERS = 7  # number of second- and third-order moments, which describe the shape
PLACE_FEATURES = ("xg", "yg", "area")  # features of the target's position and size


class ViewCheck:
    """Comparison of the goal with the mean of the images since the camera's arrival."""

    def __init__(self, goal: Goal) -> None:
        self._goal, self._views = goal, VectorHistory()
        # Stamp (s) of each image that has not been compared with the goal yet, and the moments that
        # each camera measured in the image.
        self._pending_views: deque[tuple[float, list[Moments | None]]] = deque(maxlen=MAX_WINDOW)
        self._names: tuple[str, ...] = ()  # names of the cameras; empty if there is only one camera
        self._goal_views = [_GoalView(goal)]
        self.clear()

    def __len__(self) -> int:
        """Return the number of averaged images."""
        return min(len(self._views.rows) + len(self._pending_views), MAX_WINDOW)

    def clear(self) -> None:
        """Remove all images."""
        self._views.clear()
        self._pending_views.clear()
        # Result of `_average_views`; None until it is computed.
        self._average: tuple[np.ndarray, np.ndarray] | None = None
        self._expected_place: _ExpectedPlace | None = None

    def add(self, observation: Observation) -> None:
        """Add one image."""
        moments, others = [observation.moments], observation.other_cameras
        if others or self._names:
            names = tuple(observation.cameras) if others else ()
            if names != self._names:
                self._names, goal = names, self._goal
                # A camera without a goal is compared with the goal of the first camera.
                goals = [goal.cameras.get(name, goal) for name in names] or [goal]
                self._goal_views = [_GoalView(one) for one in goals]
            moments += [view.moments for view in others.values()]
        self._pending_views.append((observation.stamp, moments))

    def retain(self, count: int) -> None:
        """Compare the new images with the goal, and remove all but the latest `count` images."""
        if self._pending_views or len(self._views.rows) > count:
            self._average = None
        while len(self._pending_views) > count:
            self._pending_views.popleft()
        for stamp, views in self._pending_views:
            self._views.add(stamp, np.concatenate([
                goal.compare(moments) for moments, goal in zip(views, self._goal_views, strict=True)
            ]))  # fmt: skip
        self._pending_views.clear()
        self._views.drop_oldest(max(len(self._views.rows) - count, 0))

    def set_expected_place(
        self, observation: Observation, L: np.ndarray, covariance: np.ndarray
    ) -> None:
        """Set how much the target's position and size may differ from the goal's.

        Args:
            observation: observation of the present image.
            L: (k, 6) interaction matrix of the features, in units of their tolerances. Rotations
                are scaled: they are in rad times the target's depth.
            covariance: (6, 6) covariance of the camera's offset from the goal, with rotations
                scaled in the same way.
        """
        views = (observation, *observation.other_cameras.values())
        self._expected_place = _ExpectedPlace(
            views, self._goal_views, L, covariance, self._goal.distance
        )

    def has_other_shape(self, is_turned: bool = False) -> bool:
        """Return whether the outline of the target differs from the goal's by more than noise.

        Args:
            is_turned: whether the camera may be rotated by 180 degrees from the goal, which changes
                the signs of the third-order moments.
        """
        self.retain(MAX_WINDOW)
        if len(self._views.rows) < MIN_VIEWS:
            return False
        mean, unknown = (part[:, :SHAPE_NUMBERS] for part in self._average_views())
        differs = np.abs(mean) > 1.0 + unknown
        if is_turned and self._goal.moments is not None:
            turned = mean[:, 3:] + 2.0 * self._goal_views[0].third_order / THIRD_ORDER_TOLERANCE
            differs[:, 3:] &= (np.abs(turned) > 1.0 + unknown[:, 3:]).any()
        return bool(differs.any())

    def compare_place(self, offset: np.ndarray) -> tuple[str, np.ndarray]:
        """Compare the target's position and size with the goal's.

        Args:
            offset: (6,) offset of the camera from the goal by features and kinematics, m (rotations
                are multiplied by the target's depth).

        Returns:
            Text that describes a difference which no unmeasured camera motion explains, empty if
            there is none; the camera motion (6,) that the view shows although the features do not
            measure it.
        """
        self.retain(MAX_WINDOW)
        if len(self._views.rows) < MIN_VIEWS or self._expected_place is None:
            return "", np.zeros(6)
        mean, unknown = (part[:, SHAPE_NUMBERS:].ravel() for part in self._average_views())
        return self._expected_place.compare(mean, unknown, offset)

    def _average_views(self) -> tuple[np.ndarray, np.ndarray]:
        """Return mean differences (c, 10) of the views of c cameras from the goal, and their noise.

        The noise (c, 10) is NOISE_DEVIATIONS standard deviations of the mean.
        """
        if self._average is None:
            rows = self._views.rows
            mean = rows.sum(axis=0) / len(rows)
            deviation = NOISE_DEVIATIONS * (np.sqrt(((rows - mean) ** 2).sum(axis=0)) / len(rows))
            numbers = SHAPE_NUMBERS + len(PLACE_FEATURES)
            self._average = mean.reshape(-1, numbers), deviation.reshape(-1, numbers)
        return self._average


class _GoalView:
    """Desired view of the target by one camera."""

    def __init__(self, goal: Goal) -> None:
        self._goal = goal

    @cached_property
    def second_order(self) -> np.ndarray:
        """Scale-free central moments (3,) of second order."""
        return _normalise_moments(self._goal.moments, 2)

    @cached_property
    def third_order(self) -> np.ndarray:
        """Scale-free central moments (4,) of third order."""
        return _normalise_moments(self._goal.moments, 3)

    def compare(self, measured: Moments | None) -> np.ndarray:
        """Return the difference (10,) between a view and the goal.

        The ten values are the differences of the seven second- and third-order central moments of
        the outline, in units of the tolerance, of the target's centre (normalised) and of the
        logarithm of its size. Return zeros if view and goal cannot be compared.
        """
        difference, desired = np.zeros(SHAPE_NUMBERS + len(PLACE_FEATURES)), self._goal.moments
        if measured is None or desired is None:
            return difference
        if measured.kind != desired.kind or desired.m00 <= 0.0:
            return difference
        # All second-order moments are divided by the largest one, because the mixed moment mu11 can
        # be small.
        scale = SECOND_ORDER_TOLERANCE * max(self.second_order.tolist())
        difference[:3] = (_normalise_moments(measured, 2) - self.second_order) / scale
        difference[3:SHAPE_NUMBERS] = (
            _normalise_moments(measured, 3) - self.third_order
        ) / THIRD_ORDER_TOLERANCE
        difference[SHAPE_NUMBERS:] = (
            measured.xg - desired.xg,
            measured.yg - desired.yg,
            0.5 * log(measured.area / desired.area),
        )
        return difference

    @cached_property
    def place_interaction(self) -> np.ndarray:
        """L (3, 6) of the target's centre and the logarithm of its size at the goal."""
        moments = self._goal.moments
        if moments is None:
            return np.zeros((len(PLACE_FEATURES), 6))
        plane = self._goal.plane or Plane.fronto_parallel(self._goal.distance)
        try:
            L = np.array(camera_features.compute_moment_features(moments, PLACE_FEATURES, plane).L)
        except VisionError:  # the goal's moments are of too low an order
            return np.zeros((len(PLACE_FEATURES), 6))
        L[2] /= 2.0 * moments.area
        return L


class _ExpectedPlace:
    """Limits for differences between the target's position and size and those at the goal.

    They are computed when the first view is compared. The arguments are the observation and the
    desired view of each camera, those of `ViewCheck.set_expected_place`, and the depth (m) of the
    target at the goal.
    """

    def __init__(
        self, views: Sequence[Observation], goals: Sequence[_GoalView], L: np.ndarray,
        covariance: np.ndarray, depth: float,
    ) -> None:
        self._views, self._goals = views, goals
        self._L, self._covariance, self._depth = L, covariance, depth

    @cached_property
    def _rows(self) -> np.ndarray:
        """L (3 c, 6) of position and size for c cameras."""
        return np.vstack([
            view.transform_to_control(goal.place_interaction)
            for view, goal in zip(self._views, self._goals, strict=True)
        ]) / ([1.0] * 3 + [self._depth] * 3)  # fmt: skip

    @cached_property
    def _limit(self) -> np.ndarray:
        """Limit (3 c,) of the differences, without the noise of the views."""
        variance = np.maximum(np.diag(self._rows @ self._covariance @ self._rows.T), 0.0)
        return MAX_PLACE_DIFFERENCE + NOISE_DEVIATIONS * np.sqrt(variance)

    @cached_property
    def _visible_motions(self) -> tuple[np.ndarray, np.ndarray]:
        """Effects (m, 3 c) of the camera motions (m, 6) that only position and size reveal."""
        _, s, vt = np.linalg.svd(self._L)
        s = np.append(s, np.zeros(len(vt) - len(s)))
        unseen = vt[s * UNSEEN_MOTION * self._depth < 1.0]
        # The unmeasured directions are combined by an SVD, so that different directions have
        # independent effects on the target's position and size.
        u, s, vt = np.linalg.svd(self._rows @ unseen.T, full_matrices=False)
        is_visible = s * self._depth > MIN_SHOWN_PART
        return u[:, is_visible].T, (vt[is_visible] / s[is_visible, None]) @ unseen

    def compare(
        self, mean: np.ndarray, deviation: np.ndarray, offset: np.ndarray
    ) -> tuple[str, np.ndarray]:
        """Compare the target's position and size with the goal's; see `ViewCheck.compare_place`."""
        rest, limit = mean - self._rows @ offset, self._limit + deviation
        effects, motions = self._visible_motions
        parts = effects @ rest
        explained, motion = parts @ effects, parts @ motions
        if not (np.abs(explained) > limit).any():
            motion = np.zeros(6)
        rest = rest - explained
        if not (np.abs(rest) > limit).any():
            return "", motion
        x, y, size = rest[:3]
        return (
            f"the target's centre is {1e3 * self._depth * np.hypot(x, y):.1f} mm from its position "
            f"in the goal's image, and the target is {np.exp(size):.3f} times as large"
        ), motion


def _normalise_moments(moments: Moments, order: int) -> np.ndarray:
    """Return the scale-free central moments (order + 1,) of one order."""
    moments.mu(order, 0)  # raises an error if the order of the moments is too low
    scale = moments.m00 ** (1.0 + 0.5 * order)
    # The moments (order, 0), (order - 1, 1), ... are on an anti-diagonal of the array `centred`.
    # Reversing the order of the rows makes it a diagonal.
    return moments.centred[order::-1, : order + 1].diagonal() / scale
