"""The scheme has no answer to an image: the target is lost, or cannot be measured."""

from __future__ import annotations

from dataclasses import replace

from ...errors import POINT_BEHIND_CAMERA
from ...observation.observation import Observation
from ...records.outcomes import KEEP_TARGET_AT_REST, UNCOVER_TARGET, Outcome, make_outcome
from ...records.run_record import ImageRecord
from ...records.state import CONVERGED, HOLDING, ServoState
from ..base import DIAGNOSES, RunDiagnosis
from ..evidence import Evidence
from ..progress_check import WINDOW


@DIAGNOSES.register("target_lost")
class TargetLost(RunDiagnosis):
    """Why there is no answer: by a fault of which the loss follows, or of its own."""

    help = "the target is not found in the image, or its features cannot be measured"
    reads = "why an image has no answer, image borders that the target touches, its last steps"
    kinds = ("target_lost", "wrong_camera_model", "out_of_reach", "scheme_fault", "gain_too_high")

    def __init__(self) -> None:
        self._loss: Outcome | None = None  # why the target was lost last

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """See RunDiagnosis.judge."""
        state, observation = record.state, record.observation
        if state.scheme_output is not None:
            evidence.measured_stamp, self._loss = state.stamp, None
            return None
        if state.phase != HOLDING:
            return Outcome("running", state.reason)  # what was before is over
        if observation.valid:
            return self._judge_unmeasured(state, evidence)
        # However long ago: what was swinging when it was lost, was lost by that.
        measured = evidence.measured_stamp
        if measured is not None and (
            found := evidence.gain_check.find_recent_oscillation(measured)
        ):
            return evidence.add_advice(found)
        if self._loss is None:
            seen_wrong = evidence.current_outcome.kind == "wrong_object"
            self._loss = (
                evidence.current_outcome
                if seen_wrong
                else _explain_loss(state, observation, evidence)
            )
        return self._loss

    def _judge_unmeasured(self, state: ServoState, evidence: Evidence) -> Outcome:
        """Of an image in which the target is seen and the scheme finds no answer."""
        if evidence.measured_stamp is None:
            evidence.measured_stamp = state.stamp
        if state.stamp - evidence.measured_stamp < WINDOW:
            return Outcome("running", state.reason)
        if POINT_BEHIND_CAMERA in state.reason:
            return evidence.add_advice(make_outcome(
                "wrong_camera_model", f"the image shows the target, but {POINT_BEHIND_CAMERA} "
                                      "where that is "
                "believed to be mounted",
            ))  # fmt: skip
        return evidence.add_advice(make_outcome(
            "target_lost", f"no measurement since {evidence.measured_stamp:.2f} s: {state.reason}"
        ))  # fmt: skip


def _explain_loss(state: ServoState, observation: Observation, evidence: Evidence) -> Outcome:
    """Why the target was lost."""
    at = f"the target was lost at {state.stamp:.2f} s: {state.reason}"
    beyond, motion, covered = (
        evidence.run_context.unreachable_reason,
        evidence.motion_check,
        evidence.is_occluded,
    )
    if beyond:
        return make_outcome("out_of_reach", f"{beyond}; before it came there {at}")
    if fault := motion.find_scheme_fault(state.stamp, state.phase == CONVERGED):
        return make_outcome("scheme_fault", f"{fault}; {at}")
    moves = evidence.is_running_away or covered
    if not covered and (found := evidence.gain_check.explain_loss(at)):
        return evidence.add_advice(found)
    if not moves and (
        fault := evidence.find_camera_fault(observation) or evidence.find_contradiction()
    ):
        kind = "scheme_fault" if motion.is_interaction_wrong else "wrong_camera_model"
        return make_outcome(kind, f"{fault}; {at}")
    over = f" over the {evidence.last_touched_borders}" if evidence.last_touched_borders else ""
    found = make_outcome("target_lost", f"target lost at {state.stamp:.2f} s{over}: {state.reason}")
    if covered:
        return evidence.explain_occlusion(found)
    if moves:
        return replace(found, reason=f"{found.reason}; the features moved otherwise than the "
                       "camera: the target moved", remedy=KEEP_TARGET_AT_REST)  # fmt: skip
    if evidence.measured_stamp is not None and _was_inside(observation, evidence):
        found = replace(found, reason=f"{found.reason}; it was inside of the image before",
                        remedy=UNCOVER_TARGET)  # fmt: skip
    return evidence.add_advice(found)


def _was_inside(observation: Observation, evidence: Evidence) -> bool:
    """Whether the target cannot have left the image by the motion that it had in it."""
    following = evidence.motion_check.step_check.next_region
    if evidence.last_touched_borders or following is None:
        return False
    camera = observation.camera
    columns, rows = camera.project(*following)
    inside = min(*columns, *rows) > 0.0
    return inside and max(columns) < camera.width and max(rows) < camera.height
