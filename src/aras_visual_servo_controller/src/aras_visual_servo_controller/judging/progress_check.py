"""Why the error does not shrink: from the images of the last WINDOW."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..goals.goal import DEPTH
from ..records.outcomes import Outcome, outcome
from ..records.state import SERVOING, ServoState
from .advice import more_exact, more_time, patience

if TYPE_CHECKING:
    from ..arm.resolution import Resolution

# s over which a lack of progress is judged, and the part of the error that has to be left of it.
WINDOW, PROGRESS = 1.5, 0.9
STALLS = "the error does not shrink"
# The same of an error that would be at its goal with more time: a gain of 0.1 leaves 0.93.
SLOWLY = 0.98
# Part of the window's images in which a cause has to be there, to be the cause.
MOST = 0.6
# Tolerances by which errors scatter from image to image, and the part of their whole scatter that
# this is, from which on noise hides whether the camera is at its goal.
NOISE, OF_ALL = 1.0, 0.5
# Part of its speed that a joint below its limits has; part of a run's images in which some joint is
# at its limits, from which on more time is needed.
UNSLOWED, SLOWED = 0.99, 0.3
# Commanded speed of the camera that is worth a word, depths/s; 1 rad/s counts as TURNING of them.
SLOW, TURNING = 1e-3, 0.5
# Part of the wanted rate that L can give below which the error is no camera motion's.
UNREACHED = 0.1
# s between two images from which on it is their rate, and not the gain, that makes a run slow.
SELDOM = 0.2


@dataclass(frozen=True, eq=False)
class _Seen:
    """What one servoed image leaves behind; size and error (k,) in tolerances (k,)."""

    stamp: float
    size: float
    state: ServoState
    full_rank: int
    error: np.ndarray
    tolerances: np.ndarray
    depth: float
    stretched: bool = False

    @property
    def resolution(self) -> Resolution | None:
        """Of the state."""
        return self.state.resolution

    # Each is asked for at every image of the window: worked out once.
    @cached_property
    def rank(self) -> int:
        """Of L."""
        return self.state.rank

    @cached_property
    def unreached(self) -> bool:
        """Whether the arm gives little of the twist that was asked of the camera."""
        if self.resolution is None:
            return False
        asked = _speed(self.state.twist, self.depth)
        lost = _speed(np.asarray(self.resolution.lost), self.depth)
        return asked >= SLOW and lost > 0.3 * asked

    @cached_property
    def reached(self) -> float:
        """Part of the error that some twist could take away, by L (k, 6) in tolerances."""
        L, norm = self.state.decision.L, float(np.linalg.norm(self.error))
        if L is None or len(L) != len(self.error) or norm == 0.0:
            return 1.0
        L = L * np.repeat((self.depth, 1.0), 3) / self.tolerances[:, None]
        answer = np.linalg.lstsq(L, self.error, rcond=1e-6)[0]
        return float(np.linalg.norm(L @ answer)) / norm


class ProgressCheck:
    """The images of the last WINDOW, and what they say of the way to the goal."""

    def __init__(self, duration: float = np.inf) -> None:
        """`duration`: of the run, s."""
        self._seen: deque[_Seen] = deque()
        self._duration = duration
        self._images = self._slowed = 0
        # Time, s, and size of the error at the first image and at the last that was slowed.
        self._first: tuple[float, float] | None = None
        self._slow, self._slowing = (0.0, 0.0), ""

    def clear(self) -> None:
        """Forget what was seen: the loop was interrupted."""
        self._seen.clear()

    def add(
        self, state: ServoState, tolerances: np.ndarray, depth: float = DEPTH,
        stretched: bool = False,
    ) -> np.ndarray:
        """Take in one image; its error (k,) in tolerances (k,).

        depth: of the target, m. stretched: whether an elbow of the arm is all but straight.
        """
        decision = state.decision
        error = decision.error / tolerances
        size = max(map(abs, error.tolist()))
        modelled = 6 if decision.task is None else int(decision.task.modelled.sum())
        self._seen.append(
            _Seen(state.stamp, size, state, min(modelled, len(error)), error, tolerances, depth,
                  stretched)
        )  # fmt: skip
        self._images += 1
        self._first = self._first or (state.stamp, size)
        if state.resolution is not None and state.resolution.scale < UNSLOWED:
            self._slowed += 1
            self._slow, self._slowing = (state.stamp, size), state.resolution.slowing
        while self._seen[0].stamp < state.stamp - WINDOW:
            self._seen.popleft()
        return error

    @property
    def shrinks(self) -> bool:
        """Whether the error has become less, or is within its tolerances but for noise."""
        seen = list(self._seen)
        half = len(seen) // 2
        if half == 0:
            return True
        before, after = (max(s.size for s in part) for part in (seen[:half], seen[half:]))
        return after < 1.0 or after < PROGRESS * before or _within(seen[half:])

    @property
    def period(self) -> float:
        """Mean time between two images, s; 0 where there are none."""
        seen = self._seen
        return (seen[-1].stamp - seen[0].stamp) / (len(seen) - 1) if len(seen) > 1 else 0.0

    def stalled(self, state: ServoState) -> Outcome:
        """Why the error does not shrink; 'running' while it does."""
        seen = list(self._seen)
        if state.phase != SERVOING or seen[-1].stamp - seen[0].stamp < 0.9 * WINDOW:
            return Outcome("running", state.reason)
        if self.shrinks:
            # Within the tolerances, and not there: the arm may lack the last bit.
            held_back = _within(seen[len(seen) // 2 :]) and (_limit(seen) or _reach(seen))
            return held_back or Outcome("running", state.reason)
        for cause in (_limit, _rank, _minimum) if self.noise else (_limit, _rank, _minimum, _reach):
            if (found := cause(seen)) is not None:
                return found
        if (found := self._saturated()) is not None:
            return found
        return Outcome("running", state.reason or STALLS)

    @property
    def noise(self) -> float:
        """Scatter of the loudest error from image to image, in tolerances; 0: it is no noise."""
        return _noise(self._seen)

    @property
    def _halves(self) -> tuple[float, float]:
        """Mean size of the error in the first and the second half of the images."""
        seen = list(self._seen)
        half = len(seen) // 2
        before, after = (
            float(np.mean([s.size for s in part])) if part else 0.0
            for part in (seen[:half], seen[half:])
        )
        return before, after

    def _saturated(self) -> Outcome | None:
        """That the joints are at their limits of speed, with the time that they need."""
        found = _saturation(list(self._seen))
        if found is None or self.noise:
            return None
        before, after = self._halves
        rate = (before - after) / (0.5 * WINDOW)
        return replace(found, remedy=more_time(self._duration, after, rate, linear=True))

    @property
    def slowed(self) -> Outcome | None:
        """That joints were at their limits of speed for much of the way; None: they were not."""
        if self._slowed < SLOWED * self._images:
            return None
        (begin, before), (end, after) = self._first, self._slow
        rate = (before - after) / max(end - begin, 1e-9)
        return replace(outcome(
            "saturation", f"{self._slowing} was at its limit of speed or acceleration in "
            f"{100.0 * self._slowed / self._images:.0f} % of the images",
        ), remedy=more_time(self._duration, self._seen[-1].size, rate, linear=True))  # fmt: skip

    def unfinished(self, reason: str) -> Outcome:
        """What a run is whose time is over, by its last images; `reason`: as known so far."""
        if self.period > SELDOM:
            return replace(outcome(
                "too_few_images", f"{reason}; images came every {self.period:.2f} s only"
            ), remedy=patience(self.period, None, self._duration))  # fmt: skip
        seen = list(self._seen)
        for cause in (_limit, _rank) if self.noise else (_limit, _rank, _reach):
            if (found := cause(seen)) is not None:
                return found
        if (found := self._saturated()) is not None:
            return found
        if (dropped := next((s.state.dropped for s in reversed(seen) if s.state.dropped), "")):
            words = f"{reason}; {dropped}" if dropped not in reason else reason
            return replace(outcome("too_noisy", words), remedy=more_exact(self.noise))
        before, after = self._halves
        slow = self.shrinks or after < SLOWLY * before
        rate = float(np.log(max(before, 1e-9) / max(after, 1e-9))) / (0.5 * WINDOW)
        if (noise := self.noise) > 0.0:
            # What noise leaves of a rate is none.
            slow = after < PROGRESS * before
            others = more_time(self._duration, after, rate).changes if slow else ()
            return replace(outcome(
                "too_noisy", f"{reason}; from image to image the error scatters by {noise:.1f} "
                f"times its tolerance{_place(seen)}",
            ), remedy=more_exact(noise, *others))  # fmt: skip
        if slow:
            reason = reason.removesuffix(f": {STALLS}")
            return replace(
                outcome("timed_out", reason), remedy=more_time(self._duration, after, rate)
            )
        if STALLS not in reason:
            reason = f"{reason}; {STALLS}"
        return outcome("no_progress", reason)


def _speed(twist: np.ndarray, depth: float) -> float:
    """Size of a twist (6,), m/s and rad/s, in depths (m) a second."""
    return float(np.linalg.norm(twist[:3]) / depth + TURNING * np.linalg.norm(twist[3:]))


def _noise(seen: Sequence[_Seen]) -> float:
    """Scatter of the loudest error from image to image, in tolerances; 0: it is no noise, or
    little."""
    if len({len(s.error) for s in seen}) != 1 or len(seen) < 10:
        return 0.0
    errors = np.array([s.error for s in seen])
    scatter = errors.std(axis=0)
    loudest = int(scatter.argmax())
    change = np.diff(errors[:, loudest])
    # A steady motion has no second difference, white noise 6 times its variance; its change has
    # twice, and that of an error which swings from side to side at every image 4 times.
    noise = float(np.sqrt((np.diff(change) ** 2).mean() / 6.0))
    if (change**2).mean() > 3.0 * scatter[loudest] ** 2:
        return 0.0
    return noise if noise > max(NOISE, OF_ALL * scatter[loudest]) else 0.0


def _place(seen: Sequence[_Seen]) -> str:
    """How exactly one image tells the camera's place, as text; empty where L does not say."""
    last = seen[-1]
    L = last.state.decision.L
    if L is None or np.shape(L) != (len(last.error), 6):
        return ""
    scale = np.repeat((last.depth, 1.0), 3)
    inverse = np.linalg.pinv(L * scale / last.tolerances[:, None], rcond=1e-6)
    place = (np.array([s.error for s in seen]) @ inverse.T * scale).std(axis=0)
    off, turned = 1e3 * np.linalg.norm(place[:3]), np.degrees(np.linalg.norm(place[3:]))
    return f": one image tells the camera's place to {off:.2g} mm and {turned:.2g} degrees"


def _limit(seen: Sequence[_Seen]) -> Outcome | None:
    stopped = [s.resolution.stopped for s in seen if s.resolution is not None]
    if not seen or sum(bool(names) for names in stopped) < MOST * len(seen):
        return None
    joints = ", ".join(sorted({name for names in stopped for name in names}))
    return outcome("joint_limit", f"{joints} at its limit: the goal lies beyond it on this way")


def _rank(seen: Sequence[_Seen]) -> Outcome | None:
    if not seen or sum(s.rank < s.full_rank for s in seen) < MOST * len(seen):
        return None
    words = f"L has rank {seen[-1].rank} of {seen[-1].full_rank}"
    if (dropped := seen[-1].state.dropped):
        return replace(
            outcome("too_noisy", f"{words}: {dropped}"), remedy=more_exact(_noise(seen))
        )
    return outcome("singular", f"{words}: some direction of the camera is not seen")


def _minimum(seen: Sequence[_Seen]) -> Outcome | None:
    if not all(s.reached < UNREACHED for s in seen[len(seen) // 2 :]):
        return None
    words = ""
    resolution = seen[-1].resolution
    if resolution is not None and resolution.null_direction is not None:
        direction = np.round(np.asarray(resolution.null_direction), 2).tolist()
        words = f"; null direction {direction}"
    return outcome(
        "local_minimum",
        f"the camera stands still with an error {seen[-1].size:.0f} times its tolerance: L v "
        f"gives {100.0 * seen[-1].reached:.0f} % of it{words}",
    )


def _reach(seen: Sequence[_Seen]) -> Outcome | None:
    if not seen or sum(s.unreached for s in seen) < MOST * len(seen):
        return None
    resolution = seen[-1].resolution
    missing = np.round(np.asarray(resolution.lost), 4).tolist()
    if sum(s.stretched for s in seen) > MOST * len(seen):
        return outcome(
            "out_of_reach", "the arm is stretched, and where the features are the goal's lies "
            f"beyond its reach; lost of the commanded twist: {missing}",
        )  # fmt: skip
    return outcome("singular", f"the arm has not the directions asked for; lost: {missing}")


def _saturation(seen: Sequence[_Seen]) -> Outcome | None:
    slowed = [s.resolution for s in seen if s.resolution and s.resolution.scale < UNSLOWED]
    if not slowed or len(slowed) < MOST * len(seen):
        return None
    joint = slowed[-1].slowing
    return outcome("saturation", f"{joint} is at its limit of speed or acceleration")


def _within(seen: Sequence[_Seen]) -> bool:
    """Whether errors are within their tolerances but for noise, which has no cause to be named."""
    errors = [s.error for s in seen]
    return len({len(e) for e in errors}) == 1 and bool((np.abs(np.mean(errors, axis=0)) < 1).all())
