"""Diagnoses of features whose motion contradicts the images, L or the camera model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...goals.goal import Goal
from ...observation.observation import Observation
from ...records.outcomes import Outcome, make_outcome
from ...records.run_record import ImageRecord
from ...records.state import CONVERGED
from ..base import DIAGNOSES, DiagnosisRule
from ..evidence import Evidence


@DIAGNOSES.register("features_contradict")
class FeaturesContradict(DiagnosisRule):
    """Detection of features that stay constant, jump or contradict L while the target does not.

    The thresholds are constants of FeatureMotionCheck and StepCheck.
    """

    help = "the features stay constant, jump or move against L, but the target does not"
    reads = "steps of the features and of the target's centre, L (`feature_motion_check.py`)"
    kinds = ("scheme_fault",)

    def __init__(self) -> None:
        self._units: tuple[str, ...] = ()  # units of the scheme's error
        self._is_angle: np.ndarray | bool = True

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """Diagnose one image, see `DiagnosisRule.judge`."""
        state, observation, goal = record.state, record.observation, evidence.run_context.goal
        scheme, motion = evidence.run_context.scheme, evidence.motion_check
        output, tolerances = state.scheme_output, np.asarray(scheme.tolerances, float)
        evidence.error = evidence.progress_check.add(
            state, tolerances, goal.distance, evidence.run_context.elbows
        )
        units = tuple(scheme.units)
        if units != self._units or len(units) != tolerances.size:
            # The error of an angle, or of a feature without a unit, may jump by one turn; that of a
            # length cannot.
            is_known = len(units) == tolerances.size
            self._units = units
            self._is_angle = np.array([unit != "m" for unit in units]) if is_known else True
        features = evidence.features
        features.add(
            observation, output.error, output.L, output.error_drift, tolerances, self._is_angle
        )
        # The L of a user-defined feature may be wrong. For such features, the target's motion is
        # computed from the target's centre instead, whose L is known.
        is_user_scheme = motion.is_user_scheme
        is_current = getattr(scheme, "can_check_camera", True)
        evidence.target_motion = evidence.target_check.add(
            features if is_current and not is_user_scheme else None, observation, goal
        )
        motion.is_current_interaction = is_current or is_user_scheme
        motion.step_check.add(features, output.names, observation)
        if is_user_scheme:
            motion.add_centre(observation)
        elif motion.step_check.unchanged_since is None:
            return None  # the only fault that is searched for in a scheme of this package
        fault = motion.find_scheme_fault(state.stamp, state.phase == CONVERGED)
        return make_outcome("scheme_fault", fault) if fault else None


@DIAGNOSES.register("wrong_camera_model")
class WrongCameraModel(DiagnosisRule):
    """Detection of features that do not move as L and the arm predict; see CameraModelCheck."""

    help = "the camera's calibration or mounting differs from the one that the controller uses"
    reads = "motion of the features, L, motion of the joints (`camera_model_check.py`)"
    kinds = ("wrong_camera_model", "joint_limit")

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """Diagnose one image, see `DiagnosisRule.judge`."""
        state, observation = record.state, record.observation
        # During a fast oscillation, L changes so much between two images that it does not predict
        # the motion of the features.
        fault = "" if evidence.is_oscillation_fast else evidence.find_camera_fault(observation)
        is_there = state.phase == CONVERGED
        if fault and not is_there and (evidence.oscillation or evidence.gain_check.delay_outcome):
            # An oscillation or overshoot of the error looks like a wrong camera model, so none is
            # reported.
            fault = ""
        evidence.camera_fault = fault
        # If the goal was taught with the present camera and the present image equals the goal's,
        # the camera is at its goal, even if the camera model is wrong. A computed goal does not
        # guarantee this.
        if not fault or is_there and is_goal_camera(observation, evidence.run_context.goal):
            return None
        stalled = evidence.progress_check.explain_stall(state)
        # A joint limit is reported first, because it stops the camera even if the camera model is
        # correct.
        if stalled.kind == "joint_limit":
            return replace(stalled, reason=f"{stalled.reason}; in addition, {fault}")
        return evidence.explain_contradiction(fault)


def is_goal_camera(observation: Observation, goal: Goal) -> bool:
    """Return whether all images come from the cameras with which the goal was taught."""
    goals = goal.cameras
    return all(name in goals and goals[name].camera == view.camera
               for name, view in observation.cameras.items())  # fmt: skip
