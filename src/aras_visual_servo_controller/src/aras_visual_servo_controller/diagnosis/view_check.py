"""Whether the cameras show at an arrival what the goal shows: where the target is, its size and its
shape.

A scheme's own numbers say that it is at its goal; image and goal are known besides, and are
compared for every scheme. A motion that L does not see is not controlled: a view that differs by
one is no fault, and the motion is what the arrival leaves open.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_camera import features as camera_features
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.interaction import Plane

from ..observation.recent_errors import RecentErrors

if TYPE_CHECKING:
    from aras_visual_servo_camera.moments import Moments

    from ..goals.goal import Goal
    from ..observation.observation import Observation

MIN_VIEWS = 3  # images that show another view in their mean, from which on it counts as one
NOISE_DEVIATIONS = 3.0  # standard deviations of that mean by which it has to be another, besides
MAX_WINDOW = 120  # images that are averaged at most
# Central moments of second and third order, free of scale, by which two views count as different;
# the first a part of the goal's greatest. Of converged runs with five cameras, noise among them,
# they differ by 0.2 % and 6e-5; of the nearest pose that was found wrong, 18 degrees off, by 0.6 %
# and 5e-4.
SECOND_ORDER_TOLERANCE, THIRD_ORDER_TOLERANCE = 0.02, 2.5e-4
# Normalised distance of the target's middle, and part of its size, by which two views count as
# different, beyond what noise and the features' accuracy explain.
MAX_PLACE_DIFFERENCE = 4e-3
# Part of the depth (and rad) by which the camera may move within the features' tolerances for them
# not to see it; and part of that motion which the view has to show, to tell how far it went.
UNSEEN_MOTION, MIN_SHOWN_PART = 0.05, 0.05
# numbers of the shape; of the target's place
SHAPE_NUMBERS, PLACE_FEATURES = 7, ("xg", "yg", "area")


class ViewCheck:
    """Compares the mean view of the images of an arrival with the goal's."""

    def __init__(self) -> None:
        self._views = RecentErrors()
        # Stamps and moments by camera, that are still to be compared.
        self._pending_views: deque[tuple[float, list[Moments | None]]] = deque(maxlen=MAX_WINDOW)
        self._goal: Goal | None = None
        self._expected_place: _ExpectedPlace | None = None
        self._names: list[str] = []  # of several cameras

    def __len__(self) -> int:
        """How many images are averaged."""
        return min(len(self._views) + len(self._pending_views), MAX_WINDOW)

    def clear(self) -> None:
        """Forget all images."""
        self._views.clear()
        self._pending_views.clear()
        self._goal = self._expected_place = None
        self._names = []

    def add(self, observation: Observation, goal: Goal) -> None:
        """Take in one image."""
        self._goal = goal
        seen = [view.moments for view in (observation, *observation.other_cameras.values())]
        self._names = list(observation.other_cameras) and list(observation.cameras)
        self._pending_views.append((observation.stamp, seen))

    def retain(self, count: int) -> None:
        """Forget all images but the latest, and compare those with the goal."""
        while len(self._pending_views) > count:
            self._pending_views.popleft()
        for stamp, seen in self._pending_views:
            goals = _list_goals(self._goal, self._names)
            self._views.add(stamp, np.concatenate([
                _compute_difference(moments, own.moments) for moments,
                own in zip(seen, goals, strict=True)
            ]))  # fmt: skip
        self._pending_views.clear()
        self._views.drop_oldest(max(len(self._views) - count, 0))

    def set_expected_place(
        self, observation: Observation, L: np.ndarray, covariance: np.ndarray, depth: float
    ) -> None:
        """How a view may differ as of this image.

        Args:
            L: (k, 6) of the features, in their tolerances; rotations times the target's depth.
            covariance: (6, 6) of the camera's offset from the goal, scaled likewise.
            depth: of the target at the goal, m.
        """
        rows = [
            _compute_place_interaction(own) if view.twist_from_control is None else
            _compute_place_interaction(own) @ view.twist_from_control
            for view, own in zip((observation, *observation.other_cameras.values()),
                                 _list_goals(self._goal, self._names), strict=True)
        ]  # fmt: skip
        self._expected_place = _ExpectedPlace(np.vstack(rows) / ([1.0] * 3 + [depth] * 3), L,
            covariance,
                                   depth)  # fmt: skip

    def has_other_shape(self, is_turned: bool = False) -> bool:
        """Whether the outline is another than the goal's, beyond what noise makes of it.

        is_turned: the camera may be half a turn off, which changes the sign of third moments.
        """
        self.retain(MAX_WINDOW)
        if len(self._views) < MIN_VIEWS:
            return False
        mean, unknown = (part[:, :SHAPE_NUMBERS] for part in self._average_views())
        differs = np.abs(mean) > 1.0 + unknown
        if is_turned and self._goal.moments is not None:
            turned = (
                mean[:, 3:]
                + 2.0 * _normalise_moments(self._goal.moments, 3) / THIRD_ORDER_TOLERANCE
            )
            differs[:, 3:] &= (np.abs(turned) > 1.0 + unknown[:, 3:]).any()
        return bool(differs.any())

    def compare_place(self, offset: np.ndarray) -> tuple[str, np.ndarray]:
        """How the target's middle and size differ from the goal's.

        Args:
            known: (6,) the camera's offset from the goal by features and kinematics, m (rotations
                times the target's depth).

        Returns:
            What no motion explains that the features do not see, as text, empty where that is
            nothing; the motion (6,) of the camera that they do not see and the view shows.
        """
        self.retain(MAX_WINDOW)
        if len(self._views) < MIN_VIEWS or self._expected_place is None:
            return "", np.zeros(6)
        mean, unknown = (part[:, SHAPE_NUMBERS:].ravel() for part in self._average_views())
        return self._expected_place.compare(mean, unknown, offset)

    def _average_views(self) -> tuple[np.ndarray, np.ndarray]:
        """The mean difference (c, 10) of c cameras' views, and CERTAIN deviations of it."""
        seen = self._views.errors
        mean, deviation = seen.mean(axis=0), seen.std(axis=0) / np.sqrt(len(seen))
        numbers = SHAPE_NUMBERS + len(PLACE_FEATURES)
        return mean.reshape(-1, numbers), NOISE_DEVIATIONS * deviation.reshape(-1, numbers)


class _ExpectedPlace:
    """How the target's place in the views may differ: rows (3 c, 6) of its L; see expect."""

    def __init__(
        self, rows: np.ndarray, L: np.ndarray, covariance: np.ndarray, depth: float
    ) -> None:
        self._rows, self._depth = rows, depth
        variance = np.maximum(np.diag(rows @ covariance @ rows.T), 0.0)
        self._limit = MAX_PLACE_DIFFERENCE + NOISE_DEVIATIONS * np.sqrt(variance)
        _, s, vt = np.linalg.svd(L)
        s = np.append(s, np.zeros(len(vt) - len(s)))
        unseen = vt[s * UNSEEN_MOTION * depth < 1.0]
        # Motions that the features do not see, by how far they move the target in the view.
        u, s, vt = np.linalg.svd(rows @ unseen.T, full_matrices=False)
        shown = s * depth > MIN_SHOWN_PART
        self._visible_directions, self._motions = (
            u[:, shown].T,
            (vt[shown] / s[shown, None]) @ unseen,
        )

    def compare(
        self, mean: np.ndarray, deviation: np.ndarray, offset: np.ndarray
    ) -> tuple[str, np.ndarray]:
        """See ViewCheck.place_differs."""
        rest, limit = mean - self._rows @ offset, self._limit + deviation
        parts = self._visible_directions @ rest
        explained = parts @ self._visible_directions
        moved = parts @ self._motions
        if not (np.abs(explained) > limit).any():
            moved = np.zeros(6)
        rest = rest - explained
        if not (np.abs(rest) > limit).any():
            return "", moved
        x, y, size = rest[:3]
        return (
            f"the target's middle is {1e3 * self._depth * np.hypot(x, y):.1f} mm from where the "
            f"goal shows it, and the target {np.exp(size):.3f} times as large"
        ), moved


def _list_goals(goal: Goal, cameras: list[str]) -> list[Goal]:
    """What each camera is to see; the first one's where it has no goal. No names: one camera."""
    return [goal.cameras.get(name, goal) for name in cameras] or [goal]


def _compute_difference(measured: Moments | None, desired: Moments | None) -> np.ndarray:
    """How the target looks other than at the goal (10,); zeros where that cannot be told.

    Of the outline central moments of second and third order, in the bounds of what is the same
    view: as many numbers as a camera has directions can be the same from several poses. Then its
    middle, normalised, and the logarithm of its size.
    """
    if measured is None or desired is None or measured.kind != desired.kind or desired.m00 <= 0.0:
        return np.zeros(SHAPE_NUMBERS + len(PLACE_FEATURES))
    second, third = (
        _normalise_moments(measured, order) - _normalise_moments(desired, order) for order in (2, 3)
    )
    place = (
        measured.xg - desired.xg,
        measured.yg - desired.yg,
        0.5 * np.log(measured.area / desired.area),
    )
    # Of squares: a mixed moment is smaller.
    return np.concatenate(
        [
            second / (SECOND_ORDER_TOLERANCE * _normalise_moments(desired, 2).max()),
            third / THIRD_ORDER_TOLERANCE,
            place,
        ]
    )


def _normalise_moments(moments: Moments, order: int) -> np.ndarray:
    """Central moments (order + 1,), free of scale."""
    scale = moments.m00 ** (1.0 + 0.5 * order)
    return np.array([moments.mu(order - j, j) for j in range(order + 1)]) / scale


def _compute_place_interaction(goal: Goal) -> np.ndarray:
    """L (3, 6) of the target's middle and the logarithm of its size at the goal."""
    moments = goal.moments
    if moments is None:
        return np.zeros((len(PLACE_FEATURES), 6))
    plane = goal.plane or Plane.fronto_parallel(goal.distance)
    try:
        L = np.array(camera_features.compute_moment_features(moments, PLACE_FEATURES, plane).L)
    except VisionError:  # moments of too low an order
        return np.zeros((len(PLACE_FEATURES), 6))
    L[2] /= 2.0 * moments.area
    return L
