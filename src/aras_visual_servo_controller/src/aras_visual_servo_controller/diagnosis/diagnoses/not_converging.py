"""The error does not shrink: a limit, a singularity, a minimum, a swing, or too little time."""

from __future__ import annotations

from ...records.outcomes import Outcome, make_outcome
from ...records.run_record import ImageRecord
from ..base import DIAGNOSES, RunDiagnosis
from ..evidence import Evidence


@DIAGNOSES.register("not_converging")
class NotConverging(RunDiagnosis):
    """The last of the order, which always answers; causes and thresholds: see ProgressCheck."""

    help = "the error does not shrink; decides whether arm, features or gain are the cause"
    reads = "error, joint limits and ranks of 1.5 s (`progress_check.py`), swings (`gain_check.py`)"
    kinds = ("running", "gain_too_high", "joint_limit", "singular", "local_minimum", "saturation",
             "out_of_reach")  # fmt: skip

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome:
        """See RunDiagnosis.judge."""
        stalled = evidence.oscillation or evidence.progress_check.explain_stall(record.state)
        if evidence.run_context.unreachable_reason and stalled.kind != "running":
            return make_outcome("out_of_reach", evidence.run_context.unreachable_reason)
        return evidence.add_advice(stalled)
