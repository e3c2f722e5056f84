"""The camera is at its goal, and what that leaves open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...records.outcomes import CALIBRATE, Arrived, Outcome, outcome
from ...records.remedy import Remedy, set_to
from ...records.run_record import ImageRecord
from ...records.state import CONVERGED
from ..base import DIAGNOSES, RunDiagnosis
from ..evidence import Evidence

MISREAD = Remedy(
    "see that the scheme compares each feature with its own number of the goal, and has more "
    "features than directions; a shipped one shows whether the goal can be reached",
    set_to("scheme", "points"),
)


@DIAGNOSES.register("converged")
class Converged(RunDiagnosis):
    """Every feature is at its goal; the arrival says how far the camera may be from it."""

    help = "the mean error is within the tolerances; decides whether the camera is at its goal"
    reads = "mean error, its noise, L, view and pose at the goal (`arrival.py`)"
    kinds = ("converged", "ambiguous")

    MISTAKEN = 2.0  # times as far as L says that a camera may be whose motion L does not explain

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """See RunDiagnosis.judge."""
        if record.state.phase != CONVERGED:
            return None
        found, fault = _arrival(record.state.arrived), evidence.camera_fault
        if found.kind == "ambiguous" and evidence.motion.is_own:
            found = replace(found, remedy=MISREAD)
        if not fault or found.kind == "ambiguous":
            return evidence.covered(found)
        return replace(
            found, reason=f"at the goal as this camera has shown it; yet {fault}",
            remedy=CALIBRATE, open_distance=self.MISTAKEN * found.open_distance,
            open_angle=min(self.MISTAKEN * found.open_angle, np.pi),
        )  # fmt: skip


def _arrival(arrived: Arrived) -> Outcome:
    """What an arrival is worth."""
    if arrived.elsewhere:
        return outcome("ambiguous", arrived.elsewhere)
    left = arrived.open
    kind = f"converged up to {left.up_to}" if left.up_to else "converged"
    return Outcome(kind, left.reason, left.remedy, left.distance, left.angle)
