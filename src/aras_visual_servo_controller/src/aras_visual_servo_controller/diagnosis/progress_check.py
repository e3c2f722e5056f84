"""Why the error does not shrink: from the images of the last WINDOW."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..goals.goal import DEFAULT_DEPTH
from ..records.outcomes import Outcome, make_outcome
from ..records.state import SERVOING, ServoState
from .advice import suggest_larger_target, suggest_longer_watchdog, suggest_more_time

if TYPE_CHECKING:
    from ..kinematics.ik_solution import IKSolution

# s over which a lack of progress is judged, and the part of the error that has to be left of it.
WINDOW, MIN_PROGRESS = 1.5, 0.9
STALL_REASON = "the error does not shrink"
# The same of an error that would be at its goal with more time: a gain of 0.1 leaves 0.93.
SLOW_PROGRESS = 0.98
# Part of the window's images in which a cause has to be there, to be the cause.
MIN_IMAGE_PART = 0.6
# Tolerances by which errors scatter from image to image, and the part of their whole scatter that
# this is, from which on noise hides whether the camera is at its goal.
MIN_NOISE, MIN_NOISE_PART = 1.0, 0.5
# Part of its speed that a joint below its limits has; part of a run's images in which some joint is
# at its limits, from which on more time is needed.
FULL_SPEED, MIN_SLOWED_PART = 0.99, 0.3
# Commanded speed of the camera that is worth a word, depths/s; 1 rad/s counts as TURNING of them.
MIN_SPEED, ROTATION_WEIGHT = 1e-3, 0.5
# Part of the wanted rate that L can give below which the error is no camera motion's.
MIN_EXPLAINED_PART = 0.1
# s between two images from which on it is their rate, and not the gain, that makes a run slow.
MAX_PERIOD = 0.2


@dataclass(frozen=True, eq=False)
class _ServoedImage:
    """What one servoed image leaves behind; size and error (k,) in tolerances (k,)."""

    stamp: float
    error_size: float
    state: ServoState
    full_rank: int
    error: np.ndarray
    tolerances: np.ndarray
    depth: float
    is_stretched: bool = False

    @property
    def ik_solution(self) -> IKSolution | None:
        """Of the state."""
        return self.state.ik_solution

    # Each is asked for at every image of the window: worked out once.
    @cached_property
    def rank(self) -> int:
        """Of L."""
        return self.state.rank

    @cached_property
    def is_infeasible(self) -> bool:
        """Whether the arm gives little of the twist that was asked of the camera."""
        if self.ik_solution is None:
            return False
        asked = _compute_speed(self.state.desired_twist, self.depth)
        lost = _compute_speed(np.asarray(self.ik_solution.infeasible_twist), self.depth)
        return asked >= MIN_SPEED and lost > 0.3 * asked

    @cached_property
    def explained_part(self) -> float:
        """Part of the error that some twist could take away, by L (k, 6) in tolerances."""
        L, norm = self.state.scheme_output.L, float(np.linalg.norm(self.error))
        if L is None or len(L) != len(self.error) or norm == 0.0:
            return 1.0
        L = L * np.repeat((self.depth, 1.0), 3) / self.tolerances[:, None]
        answer = np.linalg.lstsq(L, self.error, rcond=1e-6)[0]
        return float(np.linalg.norm(L @ answer)) / norm


class ProgressCheck:
    """The images of the last WINDOW, and what they say of the way to the goal."""

    def __init__(self, duration: float = np.inf) -> None:
        """`duration`: of the run, s."""
        self._window: deque[_ServoedImage] = deque()
        self._duration = duration
        self._image_count = self._slowed_count = 0
        # Time, s, and size of the error at the first image and at the last that was slowed.
        self._first: tuple[float, float] | None = None
        self._last_slowed, self._limiting_joint = (0.0, 0.0), ""

    def clear(self) -> None:
        """Forget what was seen: the loop was interrupted."""
        self._window.clear()

    def add(
        self, state: ServoState, tolerances: np.ndarray, depth: float = DEFAULT_DEPTH,
        is_stretched: bool = False,
    ) -> np.ndarray:
        """Take in one image; its error (k,) in tolerances (k,).

        depth: of the target, m. stretched: whether an elbow of the arm is all but straight.
        """
        decision = state.scheme_output
        error = decision.error / tolerances
        size = max(map(abs, error.tolist()))
        modelled = 6 if decision.task is None else int(decision.task.modelled.sum())
        self._window.append(
            _ServoedImage(state.stamp, size, state, min(modelled, len(error)), error, tolerances,
                depth,
                  is_stretched)
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
        """Whether the error has become less, or is within its tolerances but for noise."""
        seen = list(self._window)
        half = len(seen) // 2
        if half == 0:
            return True
        before, after = (max(s.error_size for s in part) for part in (seen[:half], seen[half:]))
        return after < 1.0 or after < MIN_PROGRESS * before or _is_within_tolerances(seen[half:])

    @property
    def period(self) -> float:
        """Mean time between two images, s; 0 where there are none."""
        seen = self._window
        return (seen[-1].stamp - seen[0].stamp) / (len(seen) - 1) if len(seen) > 1 else 0.0

    def explain_stall(self, state: ServoState) -> Outcome:
        """Why the error does not shrink; 'running' while it does."""
        seen = list(self._window)
        if state.phase != SERVOING or seen[-1].stamp - seen[0].stamp < 0.9 * WINDOW:
            return Outcome("running", state.reason)
        if self.is_shrinking:
            # Within the tolerances, and not there: the arm may lack the last bit.
            held_back = _is_within_tolerances(seen[len(seen) // 2 :]) and (
                _find_limit(seen) or _find_infeasibility(seen)
            )
            return held_back or Outcome("running", state.reason)
        for cause in (
            (_find_limit, _find_rank_loss, _find_minimum)
            if self.noise
            else (_find_limit, _find_rank_loss, _find_minimum, _find_infeasibility)
        ):
            if (found := cause(seen)) is not None:
                return found
        if (found := self._explain_saturation()) is not None:
            return found
        return Outcome("running", state.reason or STALL_REASON)

    @property
    def noise(self) -> float:
        """Scatter of the loudest error from image to image, in tolerances; 0: it is no noise."""
        return _estimate_noise(self._window)

    @property
    def _halves(self) -> tuple[float, float]:
        """Mean size of the error in the first and the second half of the images."""
        seen = list(self._window)
        half = len(seen) // 2
        before, after = (
            float(np.mean([s.error_size for s in part])) if part else 0.0
            for part in (seen[:half], seen[half:])
        )
        return before, after

    def _explain_saturation(self) -> Outcome | None:
        """That the joints are at their limits of speed, with the time that they need."""
        found = _find_saturation(list(self._window))
        if found is None or self.noise:
            return None
        before, after = self._halves
        rate = (before - after) / (0.5 * WINDOW)
        return replace(found, remedy=suggest_more_time(self._duration, after, rate, linear=True))

    @property
    def saturation_outcome(self) -> Outcome | None:
        """That joints were at their limits of speed for much of the way; None: they were not."""
        if self._slowed_count < MIN_SLOWED_PART * self._image_count:
            return None
        (begin, before), (end, after) = self._first, self._last_slowed
        rate = (before - after) / max(end - begin, 1e-9)
        return replace(make_outcome(
            "saturation", f"{self._limiting_joint} was at its limit of speed or acceleration in "
            f"{100.0 * self._slowed_count / self._image_count:.0f} % of the images",
        ), remedy=suggest_more_time(self._duration, self._window[-1].error_size, rate,
        linear=True))  # fmt: skip

    def explain_timeout(self, reason: str) -> Outcome:
        """What a run is whose time is over, by its last images; `reason`: as known so far."""
        if self.period > MAX_PERIOD:
            return replace(make_outcome(
                "too_few_images", f"{reason}; images came every {self.period:.2f} s only"
            ), remedy=suggest_longer_watchdog(self.period, None, self._duration))  # fmt: skip
        seen = list(self._window)
        for cause in (
            (_find_limit, _find_rank_loss)
            if self.noise
            else (_find_limit, _find_rank_loss, _find_infeasibility)
        ):
            if (found := cause(seen)) is not None:
                return found
        if (found := self._explain_saturation()) is not None:
            return found
        if dropped := next(
            (s.state.dropped_reason for s in reversed(seen) if s.state.dropped_reason), ""
        ):
            words = f"{reason}; {dropped}" if dropped not in reason else reason
            return replace(
                make_outcome("too_noisy", words), remedy=suggest_larger_target(self.noise)
            )
        before, after = self._halves
        slow = self.is_shrinking or after < SLOW_PROGRESS * before
        rate = float(np.log(max(before, 1e-9) / max(after, 1e-9))) / (0.5 * WINDOW)
        if (noise := self.noise) > 0.0:
            # What noise leaves of a rate is none.
            slow = after < MIN_PROGRESS * before
            others = suggest_more_time(self._duration, after, rate).changes if slow else ()
            return replace(make_outcome(
                "too_noisy", f"{reason}; from image to image the error scatters by {noise:.1f} "
                f"times its tolerance{_describe_accuracy(seen)}",
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
    """Size of a twist (6,), m/s and rad/s, in depths (m) a second."""
    return float(np.linalg.norm(twist[:3]) / depth + ROTATION_WEIGHT * np.linalg.norm(twist[3:]))


def _estimate_noise(images: Sequence[_ServoedImage]) -> float:
    """Scatter of the loudest error from image to image, in tolerances; 0: it is no noise, or
    little."""
    if len({len(s.error) for s in images}) != 1 or len(images) < 10:
        return 0.0
    errors = np.array([s.error for s in images])
    scatter = errors.std(axis=0)
    loudest = int(scatter.argmax())
    change = np.diff(errors[:, loudest])
    # A steady motion has no second difference, white noise 6 times its variance; its change has
    # twice, and that of an error which swings from side to side at every image 4 times.
    noise = float(np.sqrt((np.diff(change) ** 2).mean() / 6.0))
    if (change**2).mean() > 3.0 * scatter[loudest] ** 2:
        return 0.0
    return noise if noise > max(MIN_NOISE, MIN_NOISE_PART * scatter[loudest]) else 0.0


def _describe_accuracy(images: Sequence[_ServoedImage]) -> str:
    """How exactly one image tells the camera's place, as text; empty where L does not say."""
    last = images[-1]
    L = last.state.scheme_output.L
    if L is None or np.shape(L) != (len(last.error), 6):
        return ""
    scale = np.repeat((last.depth, 1.0), 3)
    inverse = np.linalg.pinv(L * scale / last.tolerances[:, None], rcond=1e-6)
    place = (np.array([s.error for s in images]) @ inverse.T * scale).std(axis=0)
    off, turned = 1e3 * np.linalg.norm(place[:3]), np.degrees(np.linalg.norm(place[3:]))
    return f": one image tells the camera's place to {off:.2g} mm and {turned:.2g} degrees"


def _find_limit(images: Sequence[_ServoedImage]) -> Outcome | None:
    stopped = [s.ik_solution.stopped_joints for s in images if s.ik_solution is not None]
    if not images or sum(bool(names) for names in stopped) < MIN_IMAGE_PART * len(images):
        return None
    joints = ", ".join(sorted({name for names in stopped for name in names}))
    return make_outcome(
        "joint_limit", f"{joints} at its limit: the goal lies beyond it on this way"
    )


def _find_rank_loss(images: Sequence[_ServoedImage]) -> Outcome | None:
    if not images or sum(s.rank < s.full_rank for s in images) < MIN_IMAGE_PART * len(images):
        return None
    words = f"L has rank {images[-1].rank} of {images[-1].full_rank}"
    if (dropped := images[-1].state.dropped_reason):
        return replace(
            make_outcome("too_noisy", f"{words}: {dropped}"),
            remedy=suggest_larger_target(_estimate_noise(images)),
        )
    return make_outcome("singular", f"{words}: some direction of the camera is not seen")


def _find_minimum(images: Sequence[_ServoedImage]) -> Outcome | None:
    if not all(s.explained_part < MIN_EXPLAINED_PART for s in images[len(images) // 2 :]):
        return None
    words = ""
    resolution = images[-1].ik_solution
    if resolution is not None and resolution.null_direction is not None:
        direction = np.round(np.asarray(resolution.null_direction), 2).tolist()
        words = f"; null direction {direction}"
    return make_outcome(
        "local_minimum",
        f"the camera stands still with an error {images[-1].error_size:.0f} times its tolerance: "
        "L v "
        f"gives {100.0 * images[-1].explained_part:.0f} % of it{words}",
    )


def _find_infeasibility(images: Sequence[_ServoedImage]) -> Outcome | None:
    if not images or sum(s.is_infeasible for s in images) < MIN_IMAGE_PART * len(images):
        return None
    resolution = images[-1].ik_solution
    missing = np.round(np.asarray(resolution.infeasible_twist), 4).tolist()
    if sum(s.is_stretched for s in images) > MIN_IMAGE_PART * len(images):
        return make_outcome(
            "out_of_reach", "the arm is stretched, and where the features are the goal's lies "
            f"beyond its reach; lost of the commanded twist: {missing}",
        )  # fmt: skip
    return make_outcome("singular", f"the arm has not the directions asked for; lost: {missing}")


def _find_saturation(images: Sequence[_ServoedImage]) -> Outcome | None:
    slowed = [s.ik_solution for s in images if s.ik_solution and s.ik_solution.scale < FULL_SPEED]
    if not slowed or len(slowed) < MIN_IMAGE_PART * len(images):
        return None
    joint = slowed[-1].limiting_joint
    return make_outcome("saturation", f"{joint} is at its limit of speed or acceleration")


def _is_within_tolerances(images: Sequence[_ServoedImage]) -> bool:
    """Whether errors are within their tolerances but for noise, which has no cause to be named."""
    errors = [s.error for s in images]
    return len({len(e) for e in errors}) == 1 and bool((np.abs(np.mean(errors, axis=0)) < 1).all())
