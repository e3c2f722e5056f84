"""Diagnosis of an error that does not decrease.

Possible causes are a limit, a singularity, a local minimum, an oscillation or a lack of time.
"""

from __future__ import annotations

from ...records.outcomes import Outcome, make_outcome
from ...records.run_record import ImageRecord
from ..base import DIAGNOSES, RunDiagnosis
from ..evidence import Evidence


@DIAGNOSES.register("not_converging")
class NotConverging(RunDiagnosis):
    """Search for the cause of an error that does not decrease.

    The thresholds are constants of ProgressCheck. This diagnosis is the last one in the order and
    always reports an outcome.
    """

    help = "the error does not decrease, because of the arm, the features or the gain"
    reads = (
        "error, joint limits and rank of L in 1.5 s (`progress_check.py`), oscillations "
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
