"""Check whether the error decreases, from the images of the last WINDOW seconds."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from aras_visual_servo_base.compiled import jit

from ..goals.goal import DEFAULT_DEPTH
from ..kinematics.elbow import Elbow
from ..records.outcomes import Outcome, make_outcome
from ..records.state import SERVOING, ServoState
from .advice import suggest_larger_target, suggest_longer_watchdog, suggest_more_time
from .stall_causes import (
    FULL_SPEED,
    ServoedImage,
    find_infeasibility,
    find_limit,
    find_minimum,
    find_rank_loss,
    find_saturation,
)
from .vector_history import VectorHistory

WINDOW = 1.5  # time over which the decrease of the error is evaluated, s
# There is no progress if the mean error in the second half of WINDOW exceeds this fraction of the
# mean error in the first half.
MIN_PROGRESS = 0.9
STALL_REASON = "the error does not decrease"
# The error decreases slowly if the mean error in the second half of WINDOW, divided by that in the
# first half, is between MIN_PROGRESS and this value. The run then needs more time. A gain of 0.1
# 1/s gives a ratio of 0.93.
SLOW_PROGRESS = 0.98
# If the scatter of the error from image to image exceeds both MIN_NOISE and MIN_NOISE_PART, the
# error is too noisy to show whether the camera is at its goal.
MIN_NOISE = 1.0  # scatter from image to image, in units of the tolerance
MIN_NOISE_PART = 0.5  # scatter from image to image, as a fraction of the total scatter
# The run needs more time if a joint limits the motion in more than this fraction of the run's
# images.
MIN_SLOWED_PART = 0.3
# If the mean time between two images is longer than this (s), the low frame rate, and not the gain,
# explains why the error decreases slowly.
MAX_PERIOD = 0.2

NO_SIZES = np.zeros(0)


class ProgressCheck:
    """Check of the progress towards the goal over the last WINDOW seconds."""

    def __init__(self, duration: float = np.inf) -> None:
        """Create the check.

        Args:
            duration: time limit of the run, s.
        """
        self._images: deque[ServoedImage] = deque()
        # Error (k,) of each of these images, in units of the tolerance. If the number of components
        # changes, the earlier images are removed from the history.
        self._errors = VectorHistory(WINDOW)
        self._running = Outcome()
        self._noise: float | None = None  # result of `noise`; None until it is computed
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
        self._images.clear()
        self._errors.clear()
        self._within_since = self._noise = None

    def add(
        self, state: ServoState, tolerances: np.ndarray, depth: float = DEFAULT_DEPTH,
        elbows: Sequence[Elbow] = (),
    ) -> np.ndarray:
        """Add one image and return its error (k,), in units of the tolerance.

        Args:
            state: state of the loop at the image.
            tolerances: (k,) tolerance of each component of the error.
            depth: depth of the target, m.
            elbows: elbows of the arm.
        """
        stamp, solution = state.stamp, state.ik_solution
        error = state.scheme_output.error / tolerances
        size = max(map(abs, error.tolist()))
        if size >= 1.0:
            self._within_since = None
        elif self._within_since is None:
            self._within_since = stamp
        self._images.append(ServoedImage(state, error, size, tolerances, depth, elbows))
        self._errors.add(stamp, error)
        self._image_count += 1
        self._first = self._first or (stamp, size)
        if solution is not None and solution.scale < FULL_SPEED:
            self._slowed_count += 1
            self._last_slowed, self._limiting_joint = (stamp, size), solution.limiting_joint
        self._noise = None
        while self._images[0].state.stamp < stamp - WINDOW:
            self._images.popleft()
        return error

    @property
    def is_shrinking(self) -> bool:
        """Return whether the error has decreased, or its mean is within the tolerances."""
        return self._compare_halves()[0]

    def _compare_halves(self) -> tuple[bool, bool]:
        """Compare the errors in the second half of WINDOW with those in the first half.

        Returns:
            Whether the error has decreased, or its mean is within the tolerances; whether its mean
            in the second half is within the tolerances, so that only noise remains.
        """
        errors = self._errors.rows
        # sizes of the errors before the number of their components changed
        sizes = self._sizes[: -len(errors)] if len(errors) < len(self._images) else NO_SIZES
        before, after, is_within = _compute_halves(sizes, errors)
        is_decreasing = after < 1.0 or after < MIN_PROGRESS * before
        return is_within or is_decreasing or len(self._images) < 2, is_within

    @property
    def _sizes(self) -> np.ndarray:
        """Return the sizes (m,) of the errors of all images, in units of the tolerance."""
        return np.array([image.error_size for image in self._images])

    @property
    def settled_time(self) -> float:
        """Return for how long all components of the error have been within their tolerances, s."""
        since = self._within_since
        return 0.0 if since is None else self._images[-1].state.stamp - since

    @property
    def period(self) -> float:
        """Return the mean time between two images, s; 0 if there are none."""
        images, count = self._images, len(self._images)
        return (images[-1].state.stamp - images[0].state.stamp) / (count - 1) if count > 1 else 0.0

    def explain_stall(self, state: ServoState) -> Outcome:
        """Return the outcome for an error that does not decrease.

        The outcome is 'running' while the error decreases, and while its cause is unknown.
        """
        if self._running.reason != state.reason:
            self._running = Outcome("running", state.reason)
        images = self._images
        span = images[-1].state.stamp - images[0].state.stamp
        if state.phase != SERVOING or span < 0.9 * WINDOW:
            return self._running
        is_shrinking, is_within = self._compare_halves()
        if is_shrinking and not is_within:
            return self._running
        images = list(images)
        if is_shrinking:
            # The mean error is within its tolerances, but the camera has not arrived: a limit of
            # the arm may prevent the last part of the motion.
            held_back = find_limit(images) or find_infeasibility(images)
            return held_back or self._running
        found = (
            find_limit(images)
            or find_rank_loss(images, self.noise)
            or find_minimum(images)
            or (None if self.noise else find_infeasibility(images))
            or self._explain_saturation()
        )
        return found or Outcome("running", state.reason or STALL_REASON)

    @property
    def noise(self) -> float:
        """Return the scatter of the largest error component from image to image.

        The unit is the tolerance of the component. Return 0 if the scatter is small, or if a motion
        or an oscillation causes it.
        """
        if self._noise is None:
            self._noise = self._estimate_noise()
        return self._noise

    def _estimate_noise(self) -> float:
        errors = self._errors.rows
        if len(errors) != len(self._images) or len(errors) < 10:
            return 0.0
        scatter = errors.std(axis=0)
        largest = int(scatter.argmax())
        change = np.diff(errors[:, largest])
        # The second difference of a steady motion is 0, so the motion does not count as noise. The
        # second difference of white noise has 6 times the variance of the noise.
        noise = float(np.sqrt((np.diff(change) ** 2).mean() / 6.0))
        if (change**2).mean() > 3.0 * scatter[largest] ** 2:
            return 0.0
        return noise if noise > max(MIN_NOISE, MIN_NOISE_PART * scatter[largest]) else 0.0

    @property
    def _halves(self) -> tuple[float, float]:
        """Return the mean sizes of the error in the first and the second half of WINDOW.

        The unit is the tolerance.
        """
        sizes = self._sizes
        half = len(sizes) // 2
        before, after = (
            float(part.mean()) if len(part) else 0.0 for part in (sizes[:half], sizes[half:])
        )
        return before, after

    def _explain_saturation(self) -> Outcome | None:
        """Return the outcome for joints at their speed limits, with the time that the run needs."""
        found = find_saturation(self._images)
        if found is None or self.noise:
            return None
        before, after = self._halves
        rate = (before - after) / (0.5 * WINDOW)
        return replace(found, remedy=suggest_more_time(self._duration, after, rate, linear=True))

    @property
    def saturation_outcome(self) -> Outcome | None:
        """Return the outcome for joints that were often at their speed limits, or None."""
        if not self._images or self._slowed_count < MIN_SLOWED_PART * self._image_count:
            return None
        (start, before), (end, after) = self._first, self._last_slowed
        rate = (before - after) / max(end - start, 1e-9)
        return replace(make_outcome(
            "saturation", f"{self._limiting_joint} was at its speed or acceleration limit in "
            f"{100.0 * self._slowed_count / self._image_count:.0f} % of the images",
        ), remedy=suggest_more_time(self._duration, self._images[-1].error_size, rate,
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
        images, noise = list(self._images), self.noise
        found = (
            find_limit(images)
            or find_rank_loss(images, noise)
            or (None if noise else find_infeasibility(images))
            or self._explain_saturation()
        )
        if found:
            return found
        if dropped := next(
            (s.state.dropped_reason for s in reversed(images) if s.state.dropped_reason), ""
        ):
            text = f"{reason}; {dropped}" if dropped not in reason else reason
            return replace(make_outcome("too_noisy", text), remedy=suggest_larger_target(noise))
        before, after = self._halves
        rate = float(np.log(max(before, 1e-9) / max(after, 1e-9))) / (0.5 * WINDOW)
        if noise:
            # A noisy error makes the measured rate of decrease unreliable, so a clear decrease is
            # required.
            slow = after < MIN_PROGRESS * before
            others = suggest_more_time(self._duration, after, rate).changes if slow else ()
            return replace(make_outcome(
                "too_noisy", f"{reason}; from image to image the error scatters by {noise:.1f} "
                f"times its tolerance{self._describe_accuracy()}",
            ), remedy=suggest_larger_target(noise, *others))  # fmt: skip
        if self.is_shrinking or after < SLOW_PROGRESS * before:
            reason = reason.removesuffix(f": {STALL_REASON}")
            return replace(
                make_outcome("timed_out", reason),
                remedy=suggest_more_time(self._duration, after, rate),
            )
        if STALL_REASON not in reason:
            reason = f"{reason}; {STALL_REASON}"
        return make_outcome("no_progress", reason)

    def _describe_accuracy(self) -> str:
        """Describe how accurately a single image determines the camera pose, as text.

        Return an empty text if there is no L of the features.
        """
        last = self._images[-1]
        L = last.state.scheme_output.L
        if L is None or np.shape(L) != (len(last.error), 6):
            return ""
        scale = np.repeat((last.depth, 1.0), 3)
        inverse = np.linalg.pinv(L * scale / last.tolerances[:, None], rcond=1e-6)
        pose = (self._errors.rows @ inverse.T * scale).std(axis=0)
        distance, angle = 1e3 * np.linalg.norm(pose[:3]), np.degrees(np.linalg.norm(pose[3:]))
        return (
            f": one image determines the camera's pose to {distance:.2g} mm and "
            f"{angle:.2g} degrees"
        )


@jit("f8[:], f8[:,:]", allocates=False)
def _compute_halves(sizes, errors):
    """Compare the errors in the second half of m + n images with those in the first half.

    Args:
        sizes: (m,) largest error component of each earlier image, in units of the tolerance.
        errors: (n, k) errors of the last n images.

    Returns:
        The largest sizes in the first and in the second half; whether each mean error in the second
        half is within its tolerance.
    """
    count = len(sizes) + len(errors)
    half, before, after = count // 2, 0.0, 0.0
    for i in range(count):
        size = 0.0
        if i < len(sizes):
            size = sizes[i]
        else:
            for k in range(errors.shape[1]):
                size = max(size, abs(errors[i - len(sizes), k]))
        if i < half:
            before = max(before, size)
        else:
            after = max(after, size)
    late = count - half
    is_within = 0 < late <= len(errors)
    if is_within:
        for k in range(errors.shape[1]):
            total = 0.0
            for i in range(len(errors) - late, len(errors)):
                total += errors[i, k]
            is_within &= abs(total) < late
    return before, after, is_within
