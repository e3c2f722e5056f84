"""Diagnosis of joints that do not follow their commands, or that oscillate without a command."""

from __future__ import annotations

from dataclasses import replace

from ...records.outcomes import JOINTS_DO_NOT_FOLLOW, Outcome, make_outcome
from ...records.remedy import Remedy
from ...records.run_record import ImageRecord
from ...records.state import CONVERGED
from ..advice import suggest_faster_joints
from ..base import DIAGNOSES, RunDiagnosis
from ..evidence import Evidence
from ..joint_check import describe_foreign_nodes, join_names


@DIAGNOSES.register("joints_do_not_follow")
class JointsDoNotFollow(RunDiagnosis):
    """Check of the joints' motion (see JointCheck), and of other nodes that command the joints."""

    help = "joints do not follow their commands, or another node commands them"
    reads = "commanded and measured joints (`joint_check.py`), commands of other nodes"
    kinds = (JOINTS_DO_NOT_FOLLOW,)

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """Diagnose one image, see `RunDiagnosis.judge`."""
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
