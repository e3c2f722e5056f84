"""Diagnoses of the progress towards the goal.

The camera arrives with a remaining uncertainty, or its error does not decrease. Possible causes are
a limit, a singularity, a local minimum, an oscillation or a lack of time.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...records.outcomes import CALIBRATE_CAMERA, ArrivalStatus, Outcome, make_outcome
from ...records.remedy import Remedy, set_value
from ...records.run_record import ImageRecord
from ...records.state import CONVERGED
from ..base import DIAGNOSES, DiagnosisRule
from ..evidence import Evidence

CHECK_FEATURE_ORDER = Remedy(
    "check that the scheme compares each feature with its own value at the goal, and that it has "
    "more features than degrees of freedom; a built-in scheme shows whether the goal can be "
    "reached",
    set_value("scheme", "points"),
)


@DIAGNOSES.register("converged")
class Converged(DiagnosisRule):
    """Detection of an arrival of every feature at its goal, with a bound of the remaining distance.
    """

    help = "the mean error is within the tolerances; is the camera at its goal?"
    reads = "mean error, its noise, L, view and pose at the goal (`arrival_check.py`)"
    kinds = ("converged", "ambiguous")
    phases = (CONVERGED,)

    # Factor on the uncertainty of the pose if the camera model is wrong.
    INTERACTION_ERROR_FACTOR = 2.0

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome:
        """Diagnose one image, see `DiagnosisRule.judge`."""
        found, fault = _make_arrival_outcome(record.state.arrival_status), evidence.camera_fault
        if found.kind == "ambiguous" and evidence.motion_check.is_user_scheme:
            found = replace(found, remedy=CHECK_FEATURE_ORDER)
        if not fault or found.kind == "ambiguous":
            return evidence.explain_occlusion(found)
        return replace(
            found, reason="the image equals the goal, which was taught with this camera, but "
                          f"{fault}",
            remedy=CALIBRATE_CAMERA,
            open_distance=self.INTERACTION_ERROR_FACTOR * found.open_distance,
            open_angle=min(self.INTERACTION_ERROR_FACTOR * found.open_angle, np.pi),
        )  # fmt: skip


def _make_arrival_outcome(arrival_status: ArrivalStatus) -> Outcome:
    """Return the outcome of an arrival, with its uncertainty."""
    if arrival_status.wrong_pose_reason:
        return make_outcome("ambiguous", arrival_status.wrong_pose_reason)
    uncertainty = arrival_status.pose_uncertainty
    kind = f"converged up to {uncertainty.description}" if uncertainty.description else "converged"
    return Outcome(
        kind, uncertainty.reason, uncertainty.remedy, uncertainty.distance, uncertainty.angle
    )


@DIAGNOSES.register("not_converging")
class NotConverging(DiagnosisRule):
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
        """Diagnose one image, see `DiagnosisRule.judge`."""
        stalled = evidence.oscillation or evidence.progress_check.explain_stall(record.state)
        if stalled.kind == "running":
            return stalled
        if evidence.run_context.unreachable_reason:
            return make_outcome("out_of_reach", evidence.run_context.unreachable_reason)
        return evidence.add_advice(stalled)
