"""Diagnoses of a loop that does not control the arm: the scheme fails, the loop is stopped, joints
do not follow their commands or oscillate without a command.
"""

from __future__ import annotations

from dataclasses import replace

from ...records.outcomes import JOINTS_DO_NOT_FOLLOW, Outcome, make_outcome
from ...records.remedy import Remedy
from ...records.run_record import ImageRecord
from ...records.state import CONVERGED, HOLDING, STOPPED
from ..advice import suggest_faster_joints
from ..base import DIAGNOSES, DiagnosisRule
from ..evidence import Evidence
from ..joint_tracking_check import describe_foreign_nodes, join_names


@DIAGNOSES.register("scheme_failed")
class SchemeFailed(DiagnosisRule):
    """Detection of a scheme that failed at an image."""

    help = "the scheme raised an error or returned an impossible output"
    reads = "output of the scheme for the image"
    kinds = ("scheme_fault",)
    phases = (HOLDING,)

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """Diagnose one image, see `DiagnosisRule.judge`."""
        return make_outcome("scheme_fault", record.state.reason) if record.is_faulty else None


@DIAGNOSES.register("stopped")
class Stopped(DiagnosisRule):
    """Detection of a loop that was stopped and waits for the command to start."""

    help = "the loop was stopped and waits for start"
    reads = "phase of the loop"
    kinds = ("stopped",)
    phases = (STOPPED,)

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome:
        """Diagnose one image, see `DiagnosisRule.judge`."""
        return make_outcome("stopped", record.state.reason)


@DIAGNOSES.register("joints_do_not_follow")
class JointsDoNotFollow(DiagnosisRule):
    """Check of the joints (see JointTrackingCheck), and of other nodes that command them."""

    help = "joints do not follow their commands, or another node commands them"
    reads = "commanded and measured joints (`joint_tracking_check.py`), commands of other nodes"
    kinds = (JOINTS_DO_NOT_FOLLOW,)

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """Diagnose one image, see `DiagnosisRule.judge`."""
        joints = evidence.joint_check
        if not joints.reason or record.state.phase == CONVERGED:
            return None
        found = make_outcome(JOINTS_DO_NOT_FOLLOW, joints.reason, joints.joints)
        if not record.foreign_nodes:
            slow = joints.is_slow
            return replace(found, remedy=suggest_faster_joints(found.remedy)) if slow else found
        nodes = join_names(list(dict.fromkeys(record.foreign_nodes.values())))
        return replace(
            found, reason=f"{found.reason}: {describe_foreign_nodes(record.foreign_nodes)}",
            remedy=Remedy(f"stop the commands of {nodes}; the loop then continues automatically"),
        )  # fmt: skip
