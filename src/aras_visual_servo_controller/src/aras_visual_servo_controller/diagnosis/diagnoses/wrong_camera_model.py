"""The camera is not as the controller believes: its lens, or where it is mounted."""

from __future__ import annotations

from dataclasses import replace

from ...goals.goal import Goal
from ...observation.observation import Observation
from ...records.outcomes import Outcome
from ...records.run_record import ImageRecord
from ...records.state import CONVERGED
from ..base import DIAGNOSES, RunDiagnosis
from ..evidence import Evidence


@DIAGNOSES.register("wrong_camera_model")
class WrongCameraModel(RunDiagnosis):
    """The features move otherwise than L and the arm's motion say; see CameraCheck."""

    help = "the camera is calibrated or mounted otherwise than the controller assumes"
    reads = "motion of the features, L, motion of the joints (`camera_check.py`)"
    kinds = ("wrong_camera_model", "joint_limit")

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """See RunDiagnosis.judge."""
        state, observation = record.state, record.observation
        # Between two images of a fast swing L is not what it is at either.
        fault = "" if evidence.is_oscillation_fast else evidence.find_camera_fault(observation)
        is_there = state.phase == CONVERGED
        if fault and not is_there and (evidence.oscillation or evidence.gain_check.delay_outcome):
            fault = ""  # whatever the camera is: not by a motion that is not yet over when judged
        evidence.camera_fault = fault
        # A goal that this camera has shown is where its picture is the same, whatever is believed
        # of it; a goal that was worked out is not.
        if not fault or is_there and is_goal_camera(observation, evidence.run_context.goal):
            return None
        stalled = evidence.progress_check.explain_stall(state)
        if stalled.kind == "joint_limit":  # whatever else: past its limit no joint goes on
            return replace(stalled, reason=f"{stalled.reason}; besides, {fault}")
        return evidence.explain_contradiction(fault)


def is_goal_camera(observation: Observation, goal: Goal) -> bool:
    """Whether each camera is the one that has shown its goal."""
    goals = goal.cameras
    return all(name in goals and goals[name].camera == view.camera
               for name, view in observation.cameras.items())  # fmt: skip
