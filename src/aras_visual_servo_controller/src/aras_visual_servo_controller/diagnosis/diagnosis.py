"""Diagnosis of a run, during the run or from its record: outcome, reason and remedy.

Each image is passed to the diagnoses of `ORDER` one after the other, until one of them returns an
outcome. An `outcome` is what the loop concludes from its own data. A `verdict` is based on the true
poses, which only a simulation knows.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from statistics import median

import numpy as np

from ..records.outcomes import Outcome, make_outcome
from ..records.run_record import Record, RunContext, RunEvent
from .advice import suggest_longer_watchdog
from .base import DIAGNOSES, ORDER
from .evidence import Evidence

# During servoing, an outcome of another kind replaces the reported one only after it has been found
# for at least STEADY_TIME, s. The outcome 'running' is replaced at once. There is no delay if one
# of the two outcomes is 'converged' or one of IMMEDIATE.
STEADY_TIME = 1.0
IMMEDIATE = (
    "stopped", "held", "no_joint_states", "unusable_joint_states", "joints_do_not_follow",
    "too_few_images", "target_lost", "ambiguous", "scheme_fault", "timed_out",
)  # fmt: skip
# Stops by the watchdog are forgotten if no further stop follows within this time, s.
RECOVERY_TIME = 10.0
# Images come rarely if the median period of the latest MEDIAN_PERIODS images exceeds this fraction
# of the watchdog's time. Only then are a longer watchdog and a lower gain suggested as a remedy.
RARE_PART = 0.5
MEDIAN_PERIODS = 30


def diagnose(
    run_context: RunContext, records: Iterable[Record], order: Sequence[str] = ORDER
) -> Outcome:
    """Diagnose a recorded run; the result is the same as that of `Diagnosis` during the run.

    Args:
        run_context: arm, goal, scheme and settings. If the gain of the law was changed during the
            run, the present gain is used.
        records: images and events in their order, from the start of the loop.
        order: names of the diagnoses, in the order in which they process each image.
    """
    diagnosis = Diagnosis(run_context, order)
    for record in records:
        diagnosis.add(record)
    return diagnosis.outcome


class Diagnosis:
    """Diagnosis of one run, to which records are added one by one.

    The property `outcome` is available at any time.
    """

    def __init__(self, run_context: RunContext, order: Sequence[str] = ORDER) -> None:
        """Create the diagnosis.

        Args:
            run_context: arm, goal, scheme and settings.
            order: names of the diagnoses, in the order in which they process each image; the last
                one has to report an outcome for every image.
        """
        self.run_context, self._order = run_context, tuple(order)
        self._start()

    def _start(self) -> None:
        self.evidence = Evidence(self.run_context)
        self._diagnoses = [DIAGNOSES[name]() for name in self._order]
        # Stamp (s) and fault of each image for which the scheme failed.
        self._faults: list[tuple[float, str]] = []
        self._image_count = 0
        # Stamps of the latest images, s.
        self._stamps: deque[float] = deque(maxlen=MEDIAN_PERIODS + 1)
        # Longest time without an image since the watchdog first stopped the arm, s.
        self._longest_gap = 0.0
        self._outcome_stamp = -np.inf  # time at which the present outcome was first reported, s
        # Kind of outcome that may replace the present one, and the time (s) at which this kind was
        # first found.
        self._candidate: tuple[str, float] | None = None
        self._is_ended = False
        # Number of stops by the watchdog, stamp of the last one (s), and its outcome.
        self._starvation_count, self._starvation_stamp = 0, -np.inf
        self._starvation_outcome = Outcome()

    @property
    def outcome(self) -> Outcome:
        """Return the present outcome of the run."""
        found = self.evidence.current_outcome
        if not self._faults or found.kind in ("running", "scheme_fault"):
            return found
        reason = f"{found.reason}; {self._fault_summary}" if found.reason else self._fault_summary
        return replace(found, reason=reason)

    def add(self, record: Record) -> Outcome:
        """Add an image or an event and return the present outcome."""
        if isinstance(record, RunEvent):
            self._add_event(record)
            return self.outcome
        stamp, phase, evidence = record.state.stamp, record.state.phase, self.evidence
        if record.joints is not None:
            evidence.joint_check.add(stamp, record.joints)
        self._image_count += 1
        if self._starvation_count and self._stamps:
            self._longest_gap = max(self._longest_gap, stamp - self._stamps[-1])
        self._stamps.append(stamp)
        if record.is_faulty:
            self._faults.append((stamp, record.state.reason))
        if self._is_ended:
            return self.outcome
        if record.state.scheme_output is None:
            evidence.progress_check.clear()
        for diagnosis in self._diagnoses:
            if phase in diagnosis.phases:
                found = diagnosis.judge(record, evidence)
                if found is not None:
                    break
        # After repeated stops by the watchdog, the images that arrive between two stops do not
        # change the outcome.
        is_recent = stamp - self._starvation_stamp < RECOVERY_TIME
        if found.kind == "running" and is_recent and self._starvation_count > 1:
            found = self._starvation_outcome
        elif found.kind != evidence.current_outcome.kind:
            found = self._debounce(stamp, found)
        else:
            self._candidate = None
        evidence.current_outcome = found
        return self.outcome if self._faults else found

    def _add_event(self, event: RunEvent) -> None:
        if event.kind == "started":
            self._start()
        elif event.kind == "scheme_failed":
            self.evidence.current_outcome = make_outcome("scheme_fault", event.reason)
        elif event.kind == "starved":
            self._add_starvation(event)
        elif event.kind == "timed_out":
            self._time_out(event.time)
        elif self._is_ended:
            return
        elif event.kind == "joints_unmeasured":
            self.evidence.current_outcome = event.outcome or make_outcome(
                "no_joint_states", event.reason
            )
        elif event.kind == "halted":
            self.evidence.current_outcome, self._is_ended = event.outcome, True
        else:
            raise ValueError(f"'{event.kind}' is not a kind of event of a run")

    def _add_starvation(self, event: RunEvent) -> None:
        """Record that the watchdog stopped the arm."""
        t, period = event.time, event.period
        if t - self._starvation_stamp > RECOVERY_TIME:
            self._starvation_count, self._longest_gap = 0, 0.0
        self._starvation_count += 1
        self._starvation_stamp = t
        gap = t - self._stamps[-1] if self._stamps else 0.0
        self._longest_gap = max(self._longest_gap, gap, period)
        reason = event.reason
        if self._starvation_count > 1:
            reason = (
                f"the watchdog stopped the arm {self._starvation_count} times, the last time at "
                f"{t:.2f} s"
            )
        if period > 0.0:
            reason = f"{reason}; the two images before that were {period:.3f} s apart"
        found = make_outcome("too_few_images", reason)
        if self._starvation_count > 1 and self._are_images_rare:
            gain = getattr(getattr(self.run_context.scheme, "law", None), "gain", None)
            remedy = suggest_longer_watchdog(
                self._longest_gap, gain, self.run_context.settings.duration
            )
            found = replace(found, remedy=remedy)
        self.evidence.current_outcome = self._starvation_outcome = found

    @property
    def _are_images_rare(self) -> bool:
        """Return whether most images come so late that the watchdog nearly stops the arm."""
        periods = [b - a for a, b in pairwise(self._stamps)]
        return bool(periods) and median(periods) > RARE_PART * self.run_context.settings.watchdog

    def _time_out(self, duration: float) -> None:
        """End the run because its time limit is reached; an outcome that was already found is kept.
        """
        if self.outcome.kind == "running":
            evidence, hold = self.evidence, self.run_context.settings.hold
            reason = f"not converged after {duration:.1f} s"
            if self.outcome.reason:
                reason = f"{reason}: {self.outcome.reason}"
            if 0.0 < (settled := evidence.progress_check.settled_time) < hold:
                reason = (
                    f"{reason}; each error was within its tolerance only for the last "
                    f"{settled:.2f} s, and {hold:g} s are needed"
                )
            found = evidence.add_advice(self._explain_timeout(reason))
            # An image for which the scheme failed interrupts the loop, and the camera then has to
            # settle again for `hold` seconds. A recent failure therefore explains why the run did
            # not converge in time.
            recent = self._faults and self._faults[-1][0] > (evidence.measured_stamp or 0.0) - (
                self.run_context.settings.hold
            )
            if recent and found.kind in ("timed_out", "no_progress"):
                found = make_outcome("scheme_fault", f"{found.reason}; {self._fault_summary}")
            evidence.current_outcome = found
        self._is_ended = True

    def _explain_timeout(self, reason: str) -> Outcome:
        if self.run_context.unreachable_reason:
            return make_outcome("out_of_reach", self.run_context.unreachable_reason)
        found = self.evidence.progress_check.explain_timeout(reason)
        is_slow = found.kind in ("no_progress", "timed_out")
        return is_slow and self.evidence.gain_check.explain_timeout(reason) or found

    def _debounce(self, stamp: float, candidate: Outcome) -> Outcome:
        """Return the outcome to report if the candidate is of another kind than the present one.

        An outcome that replaces another one during servoing has to be found for STEADY_TIME first.
        """
        current = self.evidence.current_outcome
        is_immediate = any(
            kind in IMMEDIATE or kind.startswith("converged")
            for kind in (candidate.kind, current.kind)
        )
        is_new = stamp - self._outcome_stamp < STEADY_TIME
        if is_immediate or current.kind == "running" or is_new:
            self._outcome_stamp, self._candidate = stamp, None
            return candidate
        if self._candidate is None or self._candidate[0] != candidate.kind:
            self._candidate = candidate.kind, stamp
        if stamp - self._candidate[1] < STEADY_TIME:
            return current
        self._outcome_stamp, self._candidate = stamp, None
        return candidate

    @property
    def _fault_summary(self) -> str:
        """Return a text that says for how many images the scheme failed, when and why."""
        first, last, reason = self._faults[0], self._faults[-1], self._faults[-1][1]
        when = f"at {first[0]:.2f} s" if first is last else (
            f"from {first[0]:.2f} s to {last[0]:.2f} s"
        )  # fmt: skip
        count = len(self._faults)
        images = f"{count} image{'s' if count > 1 else ''} of {self._image_count}"
        return f"the scheme failed for {images} ({when}): {reason}"
