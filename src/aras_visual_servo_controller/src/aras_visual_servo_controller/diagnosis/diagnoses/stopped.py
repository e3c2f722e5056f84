"""Diagnosis of a stopped loop."""

from __future__ import annotations

from ...records.outcomes import Outcome, make_outcome
from ...records.run_record import ImageRecord
from ...records.state import STOPPED
from ..base import DIAGNOSES, RunDiagnosis
from ..evidence import Evidence


@DIAGNOSES.register("stopped")
class Stopped(RunDiagnosis):
    """Detection of a loop that was stopped and waits for the command to start."""

    help = "the loop was stopped and waits for start"
    reads = "phase of the loop"
    kinds = ("stopped",)

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """Diagnose one image, see `RunDiagnosis.judge`."""
        state = record.state
        return make_outcome("stopped", state.reason) if state.phase == STOPPED else None
