"""Diagnosis of a scheme that raised an error or returned an impossible output."""

from __future__ import annotations

from ...records.outcomes import Outcome, make_outcome
from ...records.run_record import ImageRecord
from ..base import DIAGNOSES, RunDiagnosis
from ..evidence import Evidence


@DIAGNOSES.register("scheme_failed")
class SchemeFailed(RunDiagnosis):
    """Detection of a scheme that failed at an image."""

    help = "the scheme raised an error or returned an impossible output"
    reads = "output of the scheme for the image"
    kinds = ("scheme_fault",)

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """Diagnose one image, see `RunDiagnosis.judge`."""
        return make_outcome("scheme_fault", record.state.reason) if record.is_faulty else None
