"""The camera is at its goal, and what that leaves open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...records.outcomes import CALIBRATE_CAMERA, ArrivalStatus, Outcome, make_outcome
from ...records.remedy import Remedy, set_value
from ...records.run_record import ImageRecord
from ...records.state import CONVERGED
from ..base import DIAGNOSES, RunDiagnosis
from ..evidence import Evidence

CHECK_FEATURE_ORDER = Remedy(
    "see that the scheme compares each feature with its own number of the goal, and has more "
    "features than directions; a shipped one shows whether the goal can be reached",
    set_value("scheme", "points"),
)


@DIAGNOSES.register("converged")
class Converged(RunDiagnosis):
    """Every feature is at its goal; the arrival says how far the camera may be from it."""

    help = "the mean error is within the tolerances; decides whether the camera is at its goal"
    reads = "mean error, its noise, L, view and pose at the goal (`arrival.py`)"
    kinds = ("converged", "ambiguous")

    # times as far as L says that a camera may be whose motion L does not explain
    INTERACTION_ERROR_FACTOR = 2.0

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """See RunDiagnosis.judge."""
        if record.state.phase != CONVERGED:
            return None
        found, fault = _make_arrival_outcome(record.state.arrival_status), evidence.camera_fault
        if found.kind == "ambiguous" and evidence.motion_check.is_user_scheme:
            found = replace(found, remedy=CHECK_FEATURE_ORDER)
        if not fault or found.kind == "ambiguous":
            return evidence.explain_occlusion(found)
        return replace(
            found, reason=f"at the goal as this camera has shown it; yet {fault}",
            remedy=CALIBRATE_CAMERA,
            open_distance=self.INTERACTION_ERROR_FACTOR * found.open_distance,
            open_angle=min(self.INTERACTION_ERROR_FACTOR * found.open_angle, np.pi),
        )  # fmt: skip


def _make_arrival_outcome(arrival_status: ArrivalStatus) -> Outcome:
    """What an arrival is worth."""
    if arrival_status.wrong_pose_reason:
        return make_outcome("ambiguous", arrival_status.wrong_pose_reason)
    left = arrival_status.pose_uncertainty
    kind = f"converged up to {left.description}" if left.description else "converged"
    return Outcome(kind, left.reason, left.remedy, left.distance, left.angle)
