"""Diagnosis of a target that moves."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from ...records.outcomes import Outcome, make_outcome
from ...records.run_record import ImageRecord
from ...records.state import CONVERGED
from ..base import DIAGNOSES, DiagnosisRule
from ..camera_model_check import CameraModelCheck
from ..evidence import Evidence, combine_outcomes
from ..feature_rows import FeatureHistory


@DIAGNOSES.register("target_moves")
class TargetMoves(DiagnosisRule):
    """Detection of a moving target.

    The target moves if the features' motion cannot be explained by the camera's motion alone, but
    by the motions of camera and target together. See TargetMotionCheck for the fit.
    """

    help = "the target moves during servoing"
    reads = "motion of the features, L, motion of the camera (`target_motion_check.py`)"
    kinds = ("target_moves", "wrong_camera_model")

    # The latest motion of the features is attributed to the target if the camera's motion leaves at
    # least this fraction of it unexplained.
    MIN_TARGET_PART = 0.5
    # After a motion of the features that is attributed to the target, the camera model is not
    # checked for this time, s.
    RUNAWAY_MEMORY = 1.0

    def __init__(self) -> None:
        # Time of the last image at which only a motion of the target could explain the features, s.
        self._runaway_stamp = -np.inf

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """Update the checks of cameras and gain, and diagnose the image; see `DiagnosisRule.judge`.
        """
        state, observation, run = record.state, record.observation, evidence.run_context
        motion = evidence.motion_check
        if (
            motion.is_current_interaction
            and motion.target_step_check.target_motion_part > self.MIN_TARGET_PART
        ):
            self._runaway_stamp = state.stamp
        evidence.is_running_away = state.stamp - self._runaway_stamp < self.RUNAWAY_MEMORY
        if evidence.target_motion:
            # The camera checks have used images in which the target moved, so they start again.
            evidence.camera_checks.clear()
        elif getattr(run.scheme, "can_check_camera", True):
            parts = {observation.name: evidence.features}
            if observation.other_cameras:
                parts = split_by_camera(
                    evidence.features, state.scheme_output.names, observation.cameras
                )
            for name, features in parts.items():
                check = evidence.camera_checks.get(name)
                if check is None:
                    check = evidence.camera_checks[name] = CameraModelCheck(run.jacobian)
                check.add(features, observation)
        evidence.oscillation = evidence.gain_check.add(
            state.stamp, evidence.error, run.scheme, record.age
        )
        evidence.is_oscillation_fast = (
            evidence.oscillation is not None and evidence.gain_check.is_fast
        )
        if not evidence.target_motion or state.phase == CONVERGED or evidence.is_oscillation_fast:
            return None
        if evidence.target_check.has_camera_explanation and (
            fault := evidence.find_contradiction()
        ):
            return evidence.explain_contradiction(fault)
        found = make_outcome(
            "target_moves", "the motion of the features is explained by the camera's motion and a "
            f"motion of the target: {evidence.target_motion}",
        )  # fmt: skip
        oscillation = evidence.oscillation or evidence.gain_check.delay_outcome
        return evidence.explain_occlusion(
            found if oscillation is None else combine_outcomes(found, oscillation)
        )


def split_by_camera(
    features: FeatureHistory, names: Sequence[str], cameras: Collection[str]
) -> dict[str, FeatureHistory]:
    """Split the features of the images of several cameras, and return them by the camera's name.

    A feature that belongs to one of the cameras is named 'camera.feature'. All other features may
    use every camera and have an empty camera name.

    Args:
        features: features of the latest image and of the one before it.
        names: (k,) names of the features.
        cameras: names of the cameras.
    """
    now, before = features.now, features.before
    if now is None:
        return {}
    rows: dict[str, list[int]] = {}
    for i, name in enumerate(names):
        camera = name.partition(".")[0]
        rows.setdefault(camera if camera in cameras else "", []).append(i)
    return {
        camera: FeatureHistory(now[at], None if before is None else before[at])
        for camera, at in rows.items()
    }
