"""Check whether the gain of a loop is too high for the delay between image and command."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..records.outcomes import Outcome, make_outcome
from ..schemes.base import JointController, Scheme
from .advice import can_oscillate, find_gain, suggest_gain
from .oscillation_check import OscillationCheck
from .target_motion_check import TargetMotionCheck

# An oscillation is remembered for this time, s, because it may be the cause of a later loss of the
# target.
OSCILLATION_MEMORY = 1.0
# Largest product of the gain (1/s) and the delay from image to command (s). At a product of 0.8 the
# response overshoots by a third of the initial error; at pi / 2 the loop oscillates for ever.
MAX_GAIN_TIMES_AGE = 0.8
AGE_FILTER = 0.1  # weight of a new image's age (time since its exposure, s) in the running mean
OSCILLATION_RATIO = 0.25  # an oscillation due to a delay T has the frequency 0.25 / T


class GainCheck:
    """Test for an oscillating error, and for a gain that is too high for the age of the images.

    The age of an image is the time from its exposure until the command computed from it acts.

    Attributes:
        is_fast: whether the last oscillation is too fast to be fitted as a motion of the target,
            see `TargetMotionCheck.MAX_FREQUENCY`.
    """

    def __init__(self, duration: float = np.inf) -> None:
        """Create the check.

        Args:
            duration: time limit of the run, s.
        """
        self._duration, self._oscillation = duration, OscillationCheck()
        self._scheme: Scheme | JointController | None = None
        # running mean of the age of the images, plus half an image period, s
        self._mean_age: float | None = None
        self._last_stamp: float | None = None  # stamp of the last image, s
        self._last_oscillation: tuple[float, Outcome] | None = None
        self.is_fast = False

    def add(
        self, stamp: float, error: np.ndarray, scheme: Scheme | JointController, age: float
    ) -> Outcome | None:
        """Add one image and return the outcome for a recent oscillation, or None.

        Args:
            stamp: stamp of the image, s.
            error: (k,) error of the image, in units of the tolerance.
            scheme: scheme whose gain is checked.
            age: age of the image when its command acts, s.
        """
        self._scheme = scheme
        if self._last_stamp is not None:
            age += 0.5 * (stamp - self._last_stamp)
            before = age if self._mean_age is None else self._mean_age
            self._mean_age = before + AGE_FILTER * (age - before)
        self._last_stamp = stamp
        frequency = self._oscillation.add(stamp, error)
        if frequency is not None and can_oscillate(scheme, frequency):
            self.is_fast = frequency > TargetMotionCheck.MAX_FREQUENCY
            reason = f"the error oscillates at {frequency:.2f} Hz and does not die away"
            self._last_oscillation = stamp, self._make_outcome(reason, frequency)
        return self._last_oscillation and self.find_recent_oscillation(stamp)

    def find_recent_oscillation(self, stamp: float) -> Outcome | None:
        """Return the outcome if the error oscillated shortly before `stamp` (s), or None."""
        last = self._last_oscillation
        return last[1] if last is not None and stamp - last[0] < OSCILLATION_MEMORY else None

    @property
    def delay_outcome(self) -> Outcome | None:
        """Return the outcome for a gain too high for the delay from image to command, or None."""
        gain, age = find_gain(self._scheme), self._mean_age
        if gain is None or age is None or gain * age < MAX_GAIN_TIMES_AGE:
            return None
        return self._make_outcome(
            f"a gain of {gain:.2g} 1/s is too high for commands that act {age:.2f} s after their "
            f"images: above {1.0 / (np.e * age):.2g} 1/s the camera overshoots"
        )

    def explain_loss(self, circumstances: str) -> Outcome | None:
        """Return the outcome for a target that was lost due to oscillation or overshoot, or None.

        Args:
            circumstances: when and how the target was lost, as text.
        """
        if self._oscillation.is_growing:
            return self._make_outcome(
                f"the error oscillated with growing amplitude; {circumstances}"
            )
        outcome = self.delay_outcome if self._oscillation.has_overshot else None
        return outcome and replace(outcome, reason=f"{outcome.reason}; {circumstances}")

    def explain_timeout(self, reason: str) -> Outcome | None:
        """Return the outcome for a run that reached its time limit while it oscillated, or None."""
        if not self._oscillation.is_oscillating:
            return None
        return self._make_outcome(f"{reason}; the error oscillates about zero")

    def _make_outcome(self, reason: str, frequency: float | None = None) -> Outcome:
        if frequency is None and self._mean_age:
            frequency = OSCILLATION_RATIO / self._mean_age
        return replace(
            make_outcome("gain_too_high", reason),
            remedy=suggest_gain(self._scheme, frequency, self._duration),
        )
