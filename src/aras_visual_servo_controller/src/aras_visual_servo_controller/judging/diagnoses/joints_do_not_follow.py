"""Joints stay behind their commands, or swing by themselves."""

from __future__ import annotations

from dataclasses import replace

from ...records.outcomes import DO_NOT_FOLLOW, Outcome, outcome
from ...records.remedy import Remedy
from ...records.run_record import ImageRecord
from ...records.state import CONVERGED
from ..advice import faster_joints
from ..base import DIAGNOSES, RunDiagnosis
from ..evidence import Evidence
from ..joint_check import foreign_text, listed


@DIAGNOSES.register("joints_do_not_follow")
class JointsDoNotFollow(RunDiagnosis):
    """Names the joints, and the nodes that command them instead; thresholds: see JointCheck."""

    help = "joints do not do what is commanded, or another node commands them"
    reads = "commanded and measured joints (`joint_check.py`), commands of other nodes"
    kinds = (DO_NOT_FOLLOW,)

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """See RunDiagnosis.judge."""
        joints = evidence.joints
        if not joints.reason or record.state.phase == CONVERGED:
            return None
        found = outcome(DO_NOT_FOLLOW, joints.reason, joints.joints)
        if not record.foreign:
            slow = joints.slow
            return replace(found, remedy=faster_joints(found.remedy)) if slow else found
        nodes = listed(list(dict.fromkeys(record.foreign.values())))
        return replace(
            found, reason=f"{found.reason}: {foreign_text(record.foreign)}",
            remedy=Remedy(f"end the commands of {nodes}; the loop then continues by itself"),
        )  # fmt: skip
