"""A user's features do what no image can."""

from __future__ import annotations

import numpy as np

from ...records.outcomes import Outcome, outcome
from ...records.run_record import ImageRecord
from ...records.state import CONVERGED
from ..base import DIAGNOSES, RunDiagnosis
from ..evidence import Evidence


@DIAGNOSES.register("features_contradict")
class FeaturesContradict(RunDiagnosis):
    """Takes the error and its motion into the evidence; thresholds: see MotionCheck, StepCheck."""

    help = "the features stay the same, jump or move against their L, and the target does not"
    reads = "steps of the features and of the target's centre, L (`motion_check.py`)"
    kinds = ("scheme_fault",)

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """See RunDiagnosis.judge."""
        state, observation, goal = record.state, record.observation, evidence.run.goal
        scheme, motion = evidence.run.scheme, evidence.motion
        evidence.tolerances = tolerances = np.asarray(scheme.tolerances, float)
        evidence.error = evidence.progress.add(
            state, tolerances, goal.distance,
            bool(evidence.run.folds) and evidence.is_stretched(state.joints),
        )
        # What can wrap: an angle, or what may be one; a length cannot.
        evidence.angles = angles = np.array(
            [unit != "m" for unit in scheme.units] or [True] * len(tolerances)
        )
        # Features whose L may be wrong say nothing of the target.
        judges = getattr(scheme, "judges_camera", True) and not motion.is_own
        evidence.moves = evidence.target.add(
            state.decision, observation, goal, tolerances, judges, angles
        )
        motion.is_viewed = getattr(scheme, "judges_camera", True) or motion.is_own
        motion.add(state.decision, observation, goal, tolerances, angles)
        fault = motion.scheme_fault(state.stamp, state.phase == CONVERGED)
        return outcome("scheme_fault", fault) if fault else None
