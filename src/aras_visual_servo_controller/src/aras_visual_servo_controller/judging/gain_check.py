"""Whether a loop's gain is too high: its error swings, or the age of its images says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..records.outcomes import Outcome, outcome
from ..schemes.base import JointController, Scheme
from .advice import can_swing, gain_of, lower_gain
from .oscillation import Oscillation
from .target_check import TargetCheck

# s for which a swing is not forgotten: one that was cut short, or the target lost by it.
SWINGS_ON = 1.0
# Times the reciprocal of the time from image to answer that a gain may be at most: a loop of more
# overshoots by a third of its first error, of pi / 2 it never comes to rest.
HASTY = 0.8
AGEING = 0.1  # part of a mean age that a new one is
SWING = 0.25  # of the reciprocal of that time, the frequency at which a loop swings


class GainCheck:
    """Follows the error, and the age of the images when their answers act."""

    def __init__(self, duration: float = np.inf) -> None:
        """`duration`: of the run, s."""
        self._duration, self._oscillation = duration, Oscillation()
        self._scheme: Scheme | JointController | None = None
        self._age: float | None = None  # s, mean, with half of an image's period
        self._last: float | None = None  # stamp of the last image, s
        self._swung: tuple[float, Outcome] | None = None
        self._fast = False

    def add(
        self, stamp: float, error: np.ndarray, scheme: Scheme | JointController, age: float
    ) -> Outcome | None:
        """Take in one image; that the error swings, or did a moment ago.

        Args:
            error: (k,) in tolerances. age: s, of the image when its answer acts.
        """
        self._scheme = scheme
        if self._last is not None:
            age += 0.5 * (stamp - self._last)
            self._age = age if self._age is None else self._age + AGEING * (age - self._age)
        self._last = stamp
        frequency = self._oscillation.add(stamp, error)
        if frequency is not None and can_swing(scheme, frequency):
            self._fast = frequency > TargetCheck.FASTEST
            reason = f"the error oscillates at {frequency:.2f} Hz and does not die away"
            self._swung = stamp, self._found(reason, frequency)
        return self.lately(stamp)

    def lately(self, stamp: float) -> Outcome | None:
        """That the error swung a moment before `stamp`, s."""
        swung = self._swung
        return swung[1] if swung is not None and stamp - swung[0] < SWINGS_ON else None

    def swings_fast(self, stamp: float) -> bool:
        """Whether it did so faster than any target that is looked for."""
        return self._fast and self.lately(stamp) is not None

    @property
    def hasty(self) -> Outcome | None:
        """That the gain is too high for the age of the images; None: it is not."""
        gain, age = gain_of(self._scheme), self._age
        if gain is None or age is None or gain * age < HASTY:
            return None
        return self._found(
            f"a gain of {gain:.2g} 1/s is too high for answers that act {age:.2f} s after their "
            f"images: from {1.0 / (np.e * age):.2g} 1/s on the camera overshoots"
        )

    def lost(self, at: str) -> Outcome | None:
        """That the target was lost by it; `at`: when and how, as text."""
        if self._oscillation.grows:
            return self._found(f"the error went to and fro, farther each time; {at}")
        hasty = self.hasty if self._oscillation.overshot else None
        return hasty and replace(hasty, reason=f"{hasty.reason}; {at}")

    def unfinished(self, reason: str) -> Outcome | None:
        """That a run whose time is over was kept from its goal by it."""
        if not self._oscillation.swings:
            return None
        return self._found(f"{reason}; the error swings about its goal")

    def _found(self, reason: str, frequency: float | None = None) -> Outcome:
        if frequency is None and self._age:
            frequency = SWING / self._age
        return replace(
            outcome("gain_too_high", reason),
            remedy=lower_gain(self._scheme, frequency, self._duration),
        )
