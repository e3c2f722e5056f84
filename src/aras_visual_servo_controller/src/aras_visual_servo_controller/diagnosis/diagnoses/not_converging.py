"""Diagnosis of an error that does not decrease: limit, singularity, minimum, oscillation or time.
"""

from __future__ import annotations

from ...records.outcomes import Outcome, make_outcome
from ...records.run_record import ImageRecord
from ..base import DIAGNOSES, RunDiagnosis
from ..evidence import Evidence


@DIAGNOSES.register("not_converging")
class NotConverging(RunDiagnosis):
    """Causes of an error that does not decrease; their thresholds are in ProgressCheck.

    This diagnosis is the last of the order and always reports an outcome.
    """

    help = "the error does not decrease; decides whether arm, features or gain are the cause"
    reads = (
        "error, joint limits and ranks of 1.5 s (`progress_check.py`), oscillations "
        "(`gain_check.py`)"
    )
    kinds = ("running", "gain_too_high", "joint_limit", "singular", "local_minimum", "saturation",
             "out_of_reach")  # fmt: skip

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome:
        """Diagnose one image, see `RunDiagnosis.judge`."""
        stalled = evidence.oscillation or evidence.progress_check.explain_stall(record.state)
        if evidence.run_context.unreachable_reason and stalled.kind != "running":
            return make_outcome("out_of_reach", evidence.run_context.unreachable_reason)
        return evidence.add_advice(stalled)
