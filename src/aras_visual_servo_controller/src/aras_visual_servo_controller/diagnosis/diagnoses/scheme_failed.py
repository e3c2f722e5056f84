"""The scheme gave no answer: it raised, or answered what no arm can do."""

from __future__ import annotations

from ...records.outcomes import Outcome, make_outcome
from ...records.run_record import ImageRecord
from ..base import DIAGNOSES, RunDiagnosis
from ..evidence import Evidence


@DIAGNOSES.register("scheme_failed")
class SchemeFailed(RunDiagnosis):
    """The scheme failed at this image."""

    help = "the scheme raised an error or answered something impossible"
    reads = "what the scheme answered to the image"
    kinds = ("scheme_fault",)

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """See RunDiagnosis.judge."""
        return make_outcome("scheme_fault", record.state.reason) if record.is_faulty else None
