"""Diagnosis of user features that change in a way that no image can cause."""

from __future__ import annotations

import numpy as np

from ...records.outcomes import Outcome, make_outcome
from ...records.run_record import ImageRecord
from ...records.state import CONVERGED
from ..base import DIAGNOSES, RunDiagnosis
from ..evidence import Evidence


@DIAGNOSES.register("features_contradict")
class FeaturesContradict(RunDiagnosis):
    """Check of the motion of user features.

    The thresholds are constants of MotionCheck and StepCheck.
    """

    help = "the features stay constant, jump or move against L, but the target does not"
    reads = "steps of the features and of the target's centre, L (`motion_check.py`)"
    kinds = ("scheme_fault",)

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """Diagnose one image, see `RunDiagnosis.judge`."""
        state, observation, goal = record.state, record.observation, evidence.run_context.goal
        scheme, motion = evidence.run_context.scheme, evidence.motion_check
        evidence.tolerances = tolerances = np.asarray(scheme.tolerances, float)
        evidence.error = evidence.progress_check.add(
            state, tolerances, goal.distance,
            bool(evidence.run_context.elbows) and evidence.is_stretched(state.joints),
        )
        # The error of an angle, or of a feature without a unit, may jump by one turn; that of a
        # length cannot.
        evidence.is_angle = angles = np.array(
            [unit != "m" for unit in scheme.units] or [True] * len(tolerances)
        )
        # Features defined by a user may have a wrong L, so the target's motion is derived from its
        # centre instead.
        can_judge = getattr(scheme, "can_check_camera", True) and not motion.is_user_scheme
        evidence.target_motion = evidence.target_check.add(
            state.scheme_output, observation, goal, tolerances, can_judge, angles
        )
        motion.is_current_interaction = (
            getattr(scheme, "can_check_camera", True) or motion.is_user_scheme
        )
        motion.add(state.scheme_output, observation, goal, tolerances, angles)
        fault = motion.find_scheme_fault(state.stamp, state.phase == CONVERGED)
        return make_outcome("scheme_fault", fault) if fault else None
