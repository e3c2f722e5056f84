"""Check why the error does not decrease, from the images of the last WINDOW seconds."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import hypot
from typing import TYPE_CHECKING

import numpy as np

from ..goals.goal import DEFAULT_DEPTH
from ..records.outcomes import Outcome, make_outcome
from ..records.state import SERVOING, ServoState
from .advice import suggest_larger_target, suggest_longer_watchdog, suggest_more_time

if TYPE_CHECKING:
    from ..kinematics.ik_solution import IKSolution

WINDOW = 1.5  # time over which the decrease of the error is evaluated, s
# There is no progress if the mean error in the second half of WINDOW exceeds this fraction of the
# mean error in the first half.
MIN_PROGRESS = 0.9
STALL_REASON = "the error does not decrease"
# The error decreases slowly if the mean error in the second half of WINDOW, divided by that in the
# first half, is between MIN_PROGRESS and this value. The run then needs more time. A gain of 0.1
# 1/s gives a ratio of 0.93.
SLOW_PROGRESS = 0.98
# A cause of missing progress is reported if at least this fraction of the images in WINDOW shows
# it.
MIN_IMAGE_PART = 0.6
# If the scatter of the error from image to image exceeds both MIN_NOISE and MIN_NOISE_PART, the
# error is too noisy to show whether the camera is at its goal.
MIN_NOISE = 1.0  # scatter from image to image, in units of the tolerance
MIN_NOISE_PART = 0.5  # scatter from image to image, as a fraction of the total scatter
# A joint limits the motion if its limit reduces all velocities to less than this fraction.
FULL_SPEED = 0.99
# The run needs more time if a joint limits the motion in more than this fraction of the run's
# images.
MIN_SLOWED_PART = 0.3
# smallest commanded camera speed that is evaluated, in depths of the target per second
MIN_SPEED = 1e-3
# a motion is infeasible if the arm loses more than this part of the desired twist
MAX_LOST_PART = 0.3
# Weight of a rotation in the camera's speed: a rotation at 1 rad/s counts as much as a translation
# at this speed, in target depths per second.
ROTATION_WEIGHT = 0.5
# The camera is in a local minimum if, according to L, no camera motion reduces the error by at
# least this fraction.
MIN_EXPLAINED_PART = 0.1
# If the mean time between two images is longer than this (s), the low frame rate, and not the gain,
# explains why the error decreases slowly.
MAX_PERIOD = 0.2


@dataclass(eq=False)
class _ServoedImage:
    """Data of one image at which the camera was servoed.

    `error` is a list of k numbers in units of the tolerances (k,); `error_size` is the largest.
    """

    stamp: float
    error_size: float
    state: ServoState
    full_rank: int
    error: list[float]
    tolerances: np.ndarray
    depth: float
    ik_solution: IKSolution | None
    is_stretched: bool = False

    # The properties are cached, because each image is evaluated many times.
    @cached_property
    def rank(self) -> int:
        """Return the rank of L."""
        return self.state.rank

    @cached_property
    def is_infeasible(self) -> bool:
        """Return whether the arm loses too large a part of the desired camera twist."""
        if self.ik_solution is None:
            return False
        lost = _compute_speed(np.asarray(self.ik_solution.infeasible_twist), self.depth)
        if lost <= MAX_LOST_PART * MIN_SPEED:
            return False
        desired = _compute_speed(self.state.desired_twist, self.depth)
        return desired >= MIN_SPEED and lost > MAX_LOST_PART * desired

    @cached_property
    def explained_part(self) -> float:
        """Return the fraction of the error that, according to L, a camera motion can remove."""
        L, norm = self.state.scheme_output.L, float(np.linalg.norm(self.error))
        if L is None or len(L) != len(self.error) or norm == 0.0:
            return 1.0
        L = L * np.repeat((self.depth, 1.0), 3) / self.tolerances[:, None]
        twist = np.linalg.lstsq(L, self.error, rcond=1e-6)[0]
        return float(np.linalg.norm(L @ twist)) / norm


class ProgressCheck:
    """Check of the progress towards the goal over the last WINDOW seconds."""

    def __init__(self, duration: float = np.inf) -> None:
        """Create the check.

        Args:
            duration: time limit of the run, s.
        """
        self._window: deque[_ServoedImage] = deque()
        self._duration = duration
        self._image_count = self._slowed_count = 0
        # Time (s) and size of the error (in units of the tolerance) at two images: `_first` is the
        # first image, and `_last_slowed` the last one at which joint limits slowed the motion.
        self._first: tuple[float, float] | None = None
        self._last_slowed, self._limiting_joint = (0.0, 0.0), ""
        # Stamp (s) since which all components of the error have been within their tolerances; None
        # if one exceeds its tolerance in the latest image.
        self._within_since: float | None = None

    def clear(self) -> None:
        """Remove all images, because the loop was interrupted."""
        self._window.clear()
        self._within_since = None

    def add(
        self, state: ServoState, tolerances: np.ndarray, depth: float = DEFAULT_DEPTH,
        is_stretched: bool = False,
    ) -> np.ndarray:
        """Add one image and return its error (k,), in units of the tolerance.

        Args:
            state: state of the loop at the image.
            tolerances: (k,) tolerance of each component of the error.
            depth: depth of the target, m.
            is_stretched: whether an elbow of the arm is almost straight.
        """
        output = state.scheme_output
        error = output.error / tolerances
        values = error.tolist()
        size = max(map(abs, values))
        if size >= 1.0:
            self._within_since = None
        elif self._within_since is None:
            self._within_since = state.stamp
        modelled = 6 if output.task is None else output.task.modelled.tolist().count(True)
        self._window.append(
            _ServoedImage(state.stamp, size, state, min(modelled, len(error)), values, tolerances,
                          depth, state.ik_solution, is_stretched)
        )  # fmt: skip
        self._image_count += 1
        self._first = self._first or (state.stamp, size)
        if state.ik_solution is not None and state.ik_solution.scale < FULL_SPEED:
            self._slowed_count += 1
            self._last_slowed, self._limiting_joint = (
                (state.stamp, size),
                state.ik_solution.limiting_joint,
            )
        while self._window[0].stamp < state.stamp - WINDOW:
            self._window.popleft()
        return error

    @property
    def is_shrinking(self) -> bool:
        """Return whether the error has decreased, or its mean is within the tolerances."""
        images = list(self._window)
        half = len(images) // 2
        if half == 0:
            return True
        before = max([s.error_size for s in images[:half]])
        after = max([s.error_size for s in images[half:]])
        return after < 1.0 or after < MIN_PROGRESS * before or _is_within_tolerances(images[half:])

    @property
    def settled_time(self) -> float:
        """Return for how long all components of the error have been within their tolerances, s."""
        since = self._within_since
        return 0.0 if since is None else self._window[-1].stamp - since

    @property
    def period(self) -> float:
        """Return the mean time between two images, s; 0 if there are none."""
        images = self._window
        return (images[-1].stamp - images[0].stamp) / (len(images) - 1) if len(images) > 1 else 0.0

    def explain_stall(self, state: ServoState) -> Outcome:
        """Return the outcome for an error that does not decrease.

        The outcome is 'running' while the error decreases, and while its cause is unknown.
        """
        images = list(self._window)
        if state.phase != SERVOING or images[-1].stamp - images[0].stamp < 0.9 * WINDOW:
            return Outcome("running", state.reason)
        if self.is_shrinking:
            # The mean error is within its tolerances, but the camera has not arrived: a limit of
            # the arm may prevent the last part of the motion.
            held_back = _is_within_tolerances(images[len(images) // 2 :]) and (
                _find_limit(images) or _find_infeasibility(images)
            )
            return held_back or Outcome("running", state.reason)
        for cause in (
            (_find_limit, _find_rank_loss, _find_minimum)
            if self.noise
            else (_find_limit, _find_rank_loss, _find_minimum, _find_infeasibility)
        ):
            if (found := cause(images)) is not None:
                return found
        if (found := self._explain_saturation()) is not None:
            return found
        return Outcome("running", state.reason or STALL_REASON)

    @property
    def noise(self) -> float:
        """Return the scatter of the largest error component from image to image.

        The unit is the tolerance of the component. Return 0 if the scatter is small, or if a motion
        or an oscillation causes it.
        """
        return _estimate_noise(self._window)

    @property
    def _halves(self) -> tuple[float, float]:
        """Return the mean sizes of the error in the first and the second half of WINDOW.

        The unit is the tolerance.
        """
        images = list(self._window)
        half = len(images) // 2
        before, after = (
            float(np.mean([s.error_size for s in part])) if part else 0.0
            for part in (images[:half], images[half:])
        )
        return before, after

    def _explain_saturation(self) -> Outcome | None:
        """Return the outcome for joints at their speed limits, with the time that the run needs."""
        found = _find_saturation(list(self._window))
        if found is None or self.noise:
            return None
        before, after = self._halves
        rate = (before - after) / (0.5 * WINDOW)
        return replace(found, remedy=suggest_more_time(self._duration, after, rate, linear=True))

    @property
    def saturation_outcome(self) -> Outcome | None:
        """Return the outcome for joints that were often at their speed limits, or None."""
        if self._slowed_count < MIN_SLOWED_PART * self._image_count:
            return None
        (start, before), (end, after) = self._first, self._last_slowed
        rate = (before - after) / max(end - start, 1e-9)
        return replace(make_outcome(
            "saturation", f"{self._limiting_joint} was at its speed or acceleration limit in "
            f"{100.0 * self._slowed_count / self._image_count:.0f} % of the images",
        ), remedy=suggest_more_time(self._duration, self._window[-1].error_size, rate,
        linear=True))  # fmt: skip

    def explain_timeout(self, reason: str) -> Outcome:
        """Return the outcome of a run that has reached its time limit, from its last images.

        Args:
            reason: reason of the present outcome.
        """
        if self.period > MAX_PERIOD:
            return replace(make_outcome(
                "too_few_images", f"{reason}; images arrived only every {self.period:.2f} s"
            ), remedy=suggest_longer_watchdog(self.period, None, self._duration))  # fmt: skip
        images = list(self._window)
        for cause in (
            (_find_limit, _find_rank_loss)
            if self.noise
            else (_find_limit, _find_rank_loss, _find_infeasibility)
        ):
            if (found := cause(images)) is not None:
                return found
        if (found := self._explain_saturation()) is not None:
            return found
        if dropped := next(
            (s.state.dropped_reason for s in reversed(images) if s.state.dropped_reason), ""
        ):
            text = f"{reason}; {dropped}" if dropped not in reason else reason
            return replace(
                make_outcome("too_noisy", text), remedy=suggest_larger_target(self.noise)
            )
        before, after = self._halves
        slow = self.is_shrinking or after < SLOW_PROGRESS * before
        rate = float(np.log(max(before, 1e-9) / max(after, 1e-9))) / (0.5 * WINDOW)
        if (noise := self.noise) > 0.0:
            # A noisy error makes the measured rate of decrease unreliable, so a clear decrease is
            # required.
            slow = after < MIN_PROGRESS * before
            others = suggest_more_time(self._duration, after, rate).changes if slow else ()
            return replace(make_outcome(
                "too_noisy", f"{reason}; from image to image the error scatters by {noise:.1f} "
                f"times its tolerance{_describe_accuracy(images)}",
            ), remedy=suggest_larger_target(noise, *others))  # fmt: skip
        if slow:
            reason = reason.removesuffix(f": {STALL_REASON}")
            return replace(
                make_outcome("timed_out", reason),
                remedy=suggest_more_time(self._duration, after, rate),
            )
        if STALL_REASON not in reason:
            reason = f"{reason}; {STALL_REASON}"
        return make_outcome("no_progress", reason)


def _compute_speed(twist: np.ndarray, depth: float) -> float:
    """Return the size of a twist (6,), m/s and rad/s, in target depths per second.

    The argument `depth` is in m.
    """
    vx, vy, vz, wx, wy, wz = twist.tolist()
    return hypot(vx, vy, vz) / depth + ROTATION_WEIGHT * hypot(wx, wy, wz)


def _estimate_noise(images: Sequence[_ServoedImage]) -> float:
    """Return the scatter of the largest error component from image to image.

    The unit is the tolerance of the component. Return 0 if the scatter is small, or if a motion or
    an oscillation causes it.
    """
    if len({len(s.error) for s in images}) != 1 or len(images) < 10:
        return 0.0
    errors = np.array([s.error for s in images])
    scatter = errors.std(axis=0)
    largest = int(scatter.argmax())
    change = np.diff(errors[:, largest])
    # The second difference of a steady motion is 0, so the motion does not count as noise. The
    # second difference of white noise has 6 times the variance of the noise.
    noise = float(np.sqrt((np.diff(change) ** 2).mean() / 6.0))
    if (change**2).mean() > 3.0 * scatter[largest] ** 2:
        return 0.0
    return noise if noise > max(MIN_NOISE, MIN_NOISE_PART * scatter[largest]) else 0.0


def _describe_accuracy(images: Sequence[_ServoedImage]) -> str:
    """Describe how accurately a single image determines the camera pose, as text.

    Return an empty text if there is no L of the features.
    """
    last = images[-1]
    L = last.state.scheme_output.L
    if L is None or np.shape(L) != (len(last.error), 6):
        return ""
    scale = np.repeat((last.depth, 1.0), 3)
    inverse = np.linalg.pinv(L * scale / last.tolerances[:, None], rcond=1e-6)
    pose = (np.array([s.error for s in images]) @ inverse.T * scale).std(axis=0)
    distance, angle = 1e3 * np.linalg.norm(pose[:3]), np.degrees(np.linalg.norm(pose[3:]))
    return (
        f": one image determines the camera's pose to {distance:.2g} mm and {angle:.2g} degrees"
    )


def _find_limit(images: Sequence[_ServoedImage]) -> Outcome | None:
    # List comprehensions are used, because generators would need a call for each image.
    stopped = [s.ik_solution.stopped_joints for s in images
               if s.ik_solution is not None and s.ik_solution.stopped_joints]  # fmt: skip
    if not images or len(stopped) < MIN_IMAGE_PART * len(images):
        return None
    joints = ", ".join(sorted({name for names in stopped for name in names}))
    return make_outcome(
        "joint_limit", f"the path to the goal leads beyond the limit of {joints}"
    )


def _find_rank_loss(images: Sequence[_ServoedImage]) -> Outcome | None:
    if not images or sum([s.rank < s.full_rank for s in images]) < MIN_IMAGE_PART * len(images):
        return None
    text = f"L has rank {images[-1].rank} of {images[-1].full_rank}"
    if (dropped := images[-1].state.dropped_reason):
        return replace(
            make_outcome("too_noisy", f"{text}: {dropped}"),
            remedy=suggest_larger_target(_estimate_noise(images)),
        )
    return make_outcome("singular", f"{text}: the features do not measure all camera motions")


def _find_minimum(images: Sequence[_ServoedImage]) -> Outcome | None:
    if not all([s.explained_part < MIN_EXPLAINED_PART for s in images[len(images) // 2 :]]):
        return None
    text = ""
    solution = images[-1].ik_solution
    if solution is not None and solution.null_direction is not None:
        direction = np.round(np.asarray(solution.null_direction), 2).tolist()
        text = f"; null direction {direction}"
    return make_outcome(
        "local_minimum",
        f"the camera is at rest with an error of {images[-1].error_size:.0f} times its tolerance: "
        "according to L, a camera motion can reduce the error by at most "
        f"{100.0 * images[-1].explained_part:.0f} %{text}",
    )


def _find_infeasibility(images: Sequence[_ServoedImage]) -> Outcome | None:
    if not images or sum([s.is_infeasible for s in images]) < MIN_IMAGE_PART * len(images):
        return None
    solution = images[-1].ik_solution
    missing = np.round(np.asarray(solution.infeasible_twist), 4).tolist()
    if sum([s.is_stretched for s in images]) > MIN_IMAGE_PART * len(images):
        return make_outcome(
            "out_of_reach", "the arm is stretched and the goal lies beyond its reach; the arm "
            f"loses this part of the desired twist (m/s, rad/s): {missing}",
        )  # fmt: skip
    return make_outcome(
        "singular", "the arm cannot move the camera as desired; it loses this part of the desired "
        f"twist (m/s, rad/s): {missing}"
    )


def _find_saturation(images: Sequence[_ServoedImage]) -> Outcome | None:
    slowed = [s.ik_solution for s in images if s.ik_solution and s.ik_solution.scale < FULL_SPEED]
    if not slowed or len(slowed) < MIN_IMAGE_PART * len(images):
        return None
    joint = slowed[-1].limiting_joint
    return make_outcome("saturation", f"{joint} is at its speed or acceleration limit")


def _is_within_tolerances(images: Sequence[_ServoedImage]) -> bool:
    """Return whether each mean error is within its tolerance, so that only noise remains."""
    errors = [s.error for s in images]
    if len({len(e) for e in errors}) != 1:
        return False
    return all(abs(sum(component)) < len(errors) for component in zip(*errors, strict=True))
