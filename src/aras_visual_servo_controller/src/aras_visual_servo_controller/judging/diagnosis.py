"""What a run came to, why, and its remedy: while it goes on, or afterwards from its record.

The diagnoses of `ORDER` are asked one after the other about each image, and the first answer
counts. The loop knows no truth but its own: `outcome` is its word, a `verdict` only physics can
give.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from ..records.outcomes import Outcome, outcome
from ..records.run_record import ImageRecord, Record, RunContext, RunEvent
from .advice import patience
from .base import DIAGNOSES, ORDER
from .evidence import Evidence

# s for which an outcome is reported at least once it has been for as long, and those to which that
# applies: of one situation, an arm that servoes.
STEADY = 1.0
WHILE_SERVOING = (
    "running", "target_moves", "wrong_camera_model", "gain_too_high", "joint_limit", "singular",
    "local_minimum", "camera_retreat", "out_of_reach", "saturation", "too_noisy", "no_progress",
    "wrong_object",
)  # fmt: skip
# s after which an interruption of the images is forgotten: they come well since.
FORGOTTEN = 10.0


def diagnose(
    run: RunContext, records: Iterable[Record], order: Sequence[str] = ORDER
) -> Outcome:
    """What a recorded run came to: the same as `Diagnosis` says while it goes on.

    Args:
        run: arm, goal, scheme and settings; a law whose gain was changed counts as it is now.
        records: images and events in their order, from the start of the loop on.
        order: names of the diagnoses that are asked.
    """
    diagnosis = Diagnosis(run, order)
    for record in records:
        diagnosis.add(record)
    return diagnosis.outcome


class Diagnosis:
    """Follows one run record by record. Ask `outcome` at any time."""

    def __init__(self, run: RunContext, order: Sequence[str] = ORDER) -> None:
        """`order`: names of the diagnoses that are asked, of which the last always answers."""
        self.run, self._order = run, tuple(order)
        self._start()

    def _start(self) -> None:
        self.evidence = Evidence(self.run)
        self._diagnoses = [DIAGNOSES[name]() for name in self._order]
        self._faults: list[tuple[float, str]] = []  # of images, with the scheme's fault
        self._images = 0
        self._last: float | None = None  # stamp of the last image, s
        self._gap = 0.0  # longest time without an image, s
        self._since = -np.inf  # when the present outcome was found first, s
        self._other: tuple[str, float] | None = None  # kind found instead of it, and since when
        self._ended = False
        self._starvings, self._starved, self._starved_at = 0, Outcome(), -np.inf

    @property
    def outcome(self) -> Outcome:
        """What the loop knows of the run so far."""
        found = self.evidence.present
        if not self._faults or found.kind in ("running", "scheme_fault"):
            return found
        reason = f"{found.reason}; {self._faulty}" if found.reason else self._faulty
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
            self.evidence.present = outcome("scheme_fault", event.reason)
        elif event.kind == "starved":
            self._starve(event.time, event.period)
        elif event.kind == "timed_out":
            self._time_out(event.time)
        elif self._ended:
            return
        elif event.kind == "joints_unmeasured":
            self.evidence.present = outcome("no_joint_states", event.reason)
        elif event.kind == "halted":
            self.evidence.present, self._ended = event.outcome, True
        else:
            raise ValueError(f"a run has no event '{event.kind}'")

    def _starve(self, t: float, period: float) -> None:
        """The watchdog stopped the arm at t (s); period of the images before, s."""
        self._starvings = 1 if t - self._starved_at > FORGOTTEN else self._starvings + 1
        self._starved_at = t
        gap = t - self._last if self._last is not None else 0.0
        self._gap = max(self._gap, gap, period)
        found = outcome(
            "too_few_images",
            f"no image came for longer than the watchdog's time, at {t:.2f} s"
            + (f" (before that one every {period:.3f} s)" if period > 0.0 else ""),
        )
        if self._starvings > 1:
            gain = getattr(getattr(self.run.scheme, "law", None), "gain", None)
            remedy = patience(self._gap, gain, self.run.settings.duration)
            found = replace(found, remedy=remedy)
        self.evidence.present = self._starved = found

    def _time_out(self, duration: float) -> None:
        """The time for the run is over; what was found before stays the outcome."""
        if self.outcome.kind == "running":
            last = f": {self.outcome.reason}" if self.outcome.reason else ""
            evidence = self.evidence
            found = evidence.advised(
                self._unfinished(f"not at the goal after {duration:.1f} s{last}")
            )
            # An image without an answer interrupts the loop: the camera has to settle again.
            recent = self._faults and self._faults[-1][0] > (evidence.measured or 0.0) - (
                self.run.settings.hold
            )
            if recent and found.kind in ("timed_out", "no_progress"):
                found = outcome("scheme_fault", f"{found.reason}; {self._faulty}")
            evidence.present = found
        self._ended = True

    def _unfinished(self, reason: str) -> Outcome:
        if self.run.beyond:
            return outcome("out_of_reach", self.run.beyond)
        found = self.evidence.progress.unfinished(reason)
        is_slow = found.kind in ("no_progress", "timed_out")
        return is_slow and self.evidence.gain.unfinished(reason) or found

    # -- images --------------------------------------------------------------------------------

    def _add_image(self, record: ImageRecord) -> None:
        stamp, evidence, joints = record.state.stamp, self.evidence, record.joints
        if joints is not None:
            evidence.joints.add(stamp, joints.late, joints.commanded, joints.measured)
        self._images += 1
        if self._last is not None and self._starvings:
            self._gap = max(self._gap, stamp - self._last)
        self._last = stamp
        if record.is_faulty:
            self._faults.append((stamp, record.state.reason))
        if self._ended:
            return
        if record.state.decision is None:
            evidence.interrupt()
        for diagnosis in self._diagnoses:
            found = diagnosis.judge(record, evidence)
            if found is not None:
                break
        # Stopped by the watchdog again and again: the images between do not cure it.
        lately = stamp - self._starved_at < FORGOTTEN
        starved = found.kind == "running" and lately and self._starvings > 1
        evidence.present = self._starved if starved else self._steady(stamp, found)

    def _steady(self, stamp: float, found: Outcome) -> Outcome:
        """What is reported: an outcome that has been for STEADY s gives way to another one of the
        same situation only once that has been found for as long."""
        current = self.evidence.present
        if found.kind == current.kind:
            self._other = None
            return found
        family = found.kind in WHILE_SERVOING and current.kind in WHILE_SERVOING
        if not family or current.kind == "running" or stamp - self._since < STEADY:
            self._since, self._other = stamp, None
            return found
        if self._other is None or self._other[0] != found.kind:
            self._other = found.kind, stamp
        if stamp - self._other[1] < STEADY:
            return current
        self._since, self._other = stamp, None
        return found

    @property
    def _faulty(self) -> str:
        """How many images the scheme gave no answer to, when and why, as text."""
        first, last, reason = self._faults[0], self._faults[-1], self._faults[-1][1]
        when = f"at {first[0]:.2f} s" if first is last else (
            f"from {first[0]:.2f} s to {last[0]:.2f} s"
        )  # fmt: skip
        count = len(self._faults)
        images = f"{count} image{'s' if count > 1 else ''} of {self._images}"
        return f"{images} got no answer from the scheme ({when}): {reason}"
