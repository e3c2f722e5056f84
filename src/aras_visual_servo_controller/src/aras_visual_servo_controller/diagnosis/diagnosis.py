"""What a run came to, why, and its remedy: while it goes on, or afterwards from its record.

The diagnoses of `ORDER` are asked one after the other about each image, and the first answer
counts. The loop knows no truth but its own: `outcome` is its word, a `verdict` only physics can
give.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from ..records.outcomes import Outcome, make_outcome
from ..records.run_record import ImageRecord, Record, RunContext, RunEvent
from .advice import suggest_longer_watchdog
from .base import DIAGNOSES, ORDER
from .evidence import Evidence

# s for which an outcome is reported at least once it has been for as long, and those to which that
# applies: of one situation, an arm that servoes.
STEADY_TIME = 1.0
WHILE_SERVOING = (
    "running", "target_moves", "wrong_camera_model", "gain_too_high", "joint_limit", "singular",
    "local_minimum", "camera_retreat", "out_of_reach", "saturation", "too_noisy", "no_progress",
    "wrong_object",
)  # fmt: skip
# s after which an interruption of the images is forgotten: they come well since.
RECOVERY_TIME = 10.0


def diagnose(
    run_context: RunContext, records: Iterable[Record], order: Sequence[str] = ORDER
) -> Outcome:
    """What a recorded run came to: the same as `Diagnosis` says while it goes on.

    Args:
        run: arm, goal, scheme and settings; a law whose gain was changed counts as it is now.
        records: images and events in their order, from the start of the loop on.
        order: names of the diagnoses that are asked.
    """
    diagnosis = Diagnosis(run_context, order)
    for record in records:
        diagnosis.add(record)
    return diagnosis.outcome


class Diagnosis:
    """Follows one run record by record. Ask `outcome` at any time."""

    def __init__(self, run_context: RunContext, order: Sequence[str] = ORDER) -> None:
        """`order`: names of the diagnoses that are asked, of which the last always answers."""
        self.run_context, self._order = run_context, tuple(order)
        self._start()

    def _start(self) -> None:
        self.evidence = Evidence(self.run_context)
        self._diagnoses = [DIAGNOSES[name]() for name in self._order]
        self._faults: list[tuple[float, str]] = []  # of images, with the scheme's fault
        self._image_count = 0
        self._last_stamp: float | None = None  # stamp of the last image, s
        self._longest_gap = 0.0  # longest time without an image, s
        self._outcome_stamp = -np.inf  # when the present outcome was found first, s
        self._candidate: tuple[str, float] | None = None  # kind found instead of it, and since when
        self._is_ended = False
        self._starvation_count, self._starvation_outcome, self._starvation_stamp = (
            0,
            Outcome(),
            -np.inf,
        )

    @property
    def outcome(self) -> Outcome:
        """What the loop knows of the run so far."""
        found = self.evidence.current_outcome
        if not self._faults or found.kind in ("running", "scheme_fault"):
            return found
        reason = f"{found.reason}; {self._fault_summary}" if found.reason else self._fault_summary
        return replace(found, reason=reason)

    def add(self, record: Record) -> Outcome:
        """Take in an image or an event; the outcome as of now."""
        if isinstance(record, ImageRecord):
            self._add_image(record)
        else:
            self._add_event(record)
        return self.outcome

    # -- events between images ---------------------------------------------------------------

    def _add_event(self, event: RunEvent) -> None:
        if event.kind == "started":
            self._start()
        elif event.kind == "scheme_failed":
            self.evidence.current_outcome = make_outcome("scheme_fault", event.reason)
        elif event.kind == "starved":
            self._add_starvation(event.time, event.period)
        elif event.kind == "timed_out":
            self._time_out(event.time)
        elif self._is_ended:
            return
        elif event.kind == "joints_unmeasured":
            self.evidence.current_outcome = make_outcome("no_joint_states", event.reason)
        elif event.kind == "halted":
            self.evidence.current_outcome, self._is_ended = event.outcome, True
        else:
            raise ValueError(f"a run has no event '{event.kind}'")

    def _add_starvation(self, t: float, period: float) -> None:
        """The watchdog stopped the arm at t (s); period of the images before, s."""
        self._starvation_count = (
            1 if t - self._starvation_stamp > RECOVERY_TIME else self._starvation_count + 1
        )
        self._starvation_stamp = t
        gap = t - self._last_stamp if self._last_stamp is not None else 0.0
        self._longest_gap = max(self._longest_gap, gap, period)
        found = make_outcome(
            "too_few_images",
            f"no image came for longer than the watchdog's time, at {t:.2f} s"
            + (f" (before that one every {period:.3f} s)" if period > 0.0 else ""),
        )
        if self._starvation_count > 1:
            gain = getattr(getattr(self.run_context.scheme, "law", None), "gain", None)
            remedy = suggest_longer_watchdog(
                self._longest_gap, gain, self.run_context.settings.duration
            )
            found = replace(found, remedy=remedy)
        self.evidence.current_outcome = self._starvation_outcome = found

    def _time_out(self, duration: float) -> None:
        """The time for the run is over; what was found before stays the outcome."""
        if self.outcome.kind == "running":
            last = f": {self.outcome.reason}" if self.outcome.reason else ""
            evidence = self.evidence
            found = evidence.add_advice(
                self._explain_timeout(f"not at the goal after {duration:.1f} s{last}")
            )
            # An image without an answer interrupts the loop: the camera has to settle again.
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

    # -- images --------------------------------------------------------------------------------

    def _add_image(self, record: ImageRecord) -> None:
        stamp, evidence, joints = record.state.stamp, self.evidence, record.joints
        if joints is not None:
            evidence.joint_check.add(
                stamp, joints.is_late, joints.commanded_velocities, joints.measured_velocities
            )
        self._image_count += 1
        if self._last_stamp is not None and self._starvation_count:
            self._longest_gap = max(self._longest_gap, stamp - self._last_stamp)
        self._last_stamp = stamp
        if record.is_faulty:
            self._faults.append((stamp, record.state.reason))
        if self._is_ended:
            return
        if record.state.scheme_output is None:
            evidence.interrupt()
        for diagnosis in self._diagnoses:
            found = diagnosis.judge(record, evidence)
            if found is not None:
                break
        # Stopped by the watchdog again and again: the images between do not cure it.
        lately = stamp - self._starvation_stamp < RECOVERY_TIME
        starved = found.kind == "running" and lately and self._starvation_count > 1
        evidence.current_outcome = (
            self._starvation_outcome if starved else self._debounce(stamp, found)
        )

    def _debounce(self, stamp: float, candidate: Outcome) -> Outcome:
        """What is reported: an outcome that has been for STEADY s gives way to another one of the
        same situation only once that has been found for as long."""
        current = self.evidence.current_outcome
        if candidate.kind == current.kind:
            self._candidate = None
            return candidate
        family = candidate.kind in WHILE_SERVOING and current.kind in WHILE_SERVOING
        if not family or current.kind == "running" or stamp - self._outcome_stamp < STEADY_TIME:
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
        """How many images the scheme gave no answer to, when and why, as text."""
        first, last, reason = self._faults[0], self._faults[-1], self._faults[-1][1]
        when = f"at {first[0]:.2f} s" if first is last else (
            f"from {first[0]:.2f} s to {last[0]:.2f} s"
        )  # fmt: skip
        count = len(self._faults)
        images = f"{count} image{'s' if count > 1 else ''} of {self._image_count}"
        return f"{images} got no answer from the scheme ({when}): {reason}"
