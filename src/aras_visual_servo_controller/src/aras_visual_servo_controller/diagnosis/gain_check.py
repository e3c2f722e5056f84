"""Whether a loop's gain is too high: its error swings, or the age of its images says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..records.outcomes import Outcome, make_outcome
from ..schemes.base import JointController, Scheme
from .advice import can_oscillate, find_gain, suggest_gain
from .oscillation_check import OscillationCheck
from .target_check import TargetCheck

# s for which a swing is not forgotten: one that was cut short, or the target lost by it.
OSCILLATION_MEMORY = 1.0
# Times the reciprocal of the time from image to answer that a gain may be at most: a loop of more
# overshoots by a third of its first error, of pi / 2 it never comes to rest.
MAX_GAIN_TIMES_AGE = 0.8
AGE_FILTER = 0.1  # part of a mean age that a new one is
OSCILLATION_RATIO = 0.25  # of the reciprocal of that time, the frequency at which a loop swings


class GainCheck:
    """Follows the error, and the age of the images when their answers act."""

    def __init__(self, duration: float = np.inf) -> None:
        """`duration`: of the run, s."""
        self._duration, self._oscillation = duration, OscillationCheck()
        self._scheme: Scheme | JointController | None = None
        self._mean_age: float | None = None  # s, mean, with half of an image's period
        self._last_stamp: float | None = None  # stamp of the last image, s
        self._last_oscillation: tuple[float, Outcome] | None = None
        self._is_fast = False

    def add(
        self, stamp: float, error: np.ndarray, scheme: Scheme | JointController, age: float
    ) -> Outcome | None:
        """Take in one image; that the error swings, or did a moment ago.

        Args:
            error: (k,) in tolerances. age: s, of the image when its answer acts.
        """
        self._scheme = scheme
        if self._last_stamp is not None:
            age += 0.5 * (stamp - self._last_stamp)
            self._mean_age = (
                age
                if self._mean_age is None
                else self._mean_age + AGE_FILTER * (age - self._mean_age)
            )
        self._last_stamp = stamp
        frequency = self._oscillation.add(stamp, error)
        if frequency is not None and can_oscillate(scheme, frequency):
            self._is_fast = frequency > TargetCheck.MAX_FREQUENCY
            reason = f"the error oscillates at {frequency:.2f} Hz and does not die away"
            self._last_oscillation = stamp, self._make_outcome(reason, frequency)
        return self.find_recent_oscillation(stamp)

    def find_recent_oscillation(self, stamp: float) -> Outcome | None:
        """That the error swung a moment before `stamp`, s."""
        swung = self._last_oscillation
        return swung[1] if swung is not None and stamp - swung[0] < OSCILLATION_MEMORY else None

    def is_oscillating_fast(self, stamp: float) -> bool:
        """Whether it did so faster than any target that is looked for."""
        return self._is_fast and self.find_recent_oscillation(stamp) is not None

    @property
    def delay_outcome(self) -> Outcome | None:
        """That the gain is too high for the age of the images; None: it is not."""
        gain, age = find_gain(self._scheme), self._mean_age
        if gain is None or age is None or gain * age < MAX_GAIN_TIMES_AGE:
            return None
        return self._make_outcome(
            f"a gain of {gain:.2g} 1/s is too high for answers that act {age:.2f} s after their "
            f"images: from {1.0 / (np.e * age):.2g} 1/s on the camera overshoots"
        )

    def explain_loss(self, circumstances: str) -> Outcome | None:
        """That the target was lost by it; `circumstances`: when and how, as text."""
        if self._oscillation.is_growing:
            return self._make_outcome(
                f"the error went to and fro, farther each time; {circumstances}"
            )
        hasty = self.delay_outcome if self._oscillation.has_overshot else None
        return hasty and replace(hasty, reason=f"{hasty.reason}; {circumstances}")

    def explain_timeout(self, reason: str) -> Outcome | None:
        """That a run whose time is over was kept from its goal by it."""
        if not self._oscillation.is_oscillating:
            return None
        return self._make_outcome(f"{reason}; the error swings about its goal")

    def _make_outcome(self, reason: str, frequency: float | None = None) -> Outcome:
        if frequency is None and self._mean_age:
            frequency = OSCILLATION_RATIO / self._mean_age
        return replace(
            make_outcome("gain_too_high", reason),
            remedy=suggest_gain(self._scheme, frequency, self._duration),
        )
