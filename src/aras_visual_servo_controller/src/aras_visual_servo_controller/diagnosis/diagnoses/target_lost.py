"""Diagnosis of a target that is lost or cannot be measured."""

from __future__ import annotations

from dataclasses import replace

from ...errors import POINT_BEHIND_CAMERA
from ...observation.observation import Observation
from ...records.outcomes import KEEP_TARGET_AT_REST, UNCOVER_TARGET, Outcome, make_outcome
from ...records.run_record import ImageRecord
from ...records.state import CONVERGED, HOLDING, ServoState
from ..base import DIAGNOSES, DiagnosisRule
from ..evidence import Evidence
from ..progress_check import WINDOW


@DIAGNOSES.register("target_lost")
class TargetLost(DiagnosisRule):
    """Diagnosis of an image for which the scheme has no measurement.

    The cause is an earlier fault of the run, if there was one, otherwise the loss of the target.
    """

    help = "the target is not found in the image, or its features cannot be measured"
    reads = "why there is no measurement; image borders that the target touches; its last motion"
    kinds = ("target_lost", "wrong_camera_model", "out_of_reach", "scheme_fault", "gain_too_high")

    def __init__(self) -> None:
        self._loss: Outcome | None = None  # outcome of the latest loss of the target

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """Diagnose one image, see `DiagnosisRule.judge`."""
        state, observation = record.state, record.observation
        if state.scheme_output is not None:
            evidence.measured_stamp, self._loss = state.stamp, None
            return None
        if state.phase != HOLDING:
            # The loop is not servoing, so an earlier outcome is no longer valid.
            return Outcome("running", state.reason)
        if observation.valid:
            return self._judge_unmeasured(state, evidence)
        # If the error oscillated just before the target was lost, the oscillation is reported as
        # the cause for as long as the target is missing.
        last_stamp = evidence.measured_stamp
        if last_stamp is not None and (
            found := evidence.gain_check.find_recent_oscillation(last_stamp)
        ):
            return evidence.add_advice(found)
        if self._loss is None:
            is_wrong_object = evidence.current_outcome.kind == "wrong_object"
            self._loss = (
                evidence.current_outcome
                if is_wrong_object
                else _explain_loss(state, observation, evidence)
            )
        return self._loss

    def _judge_unmeasured(self, state: ServoState, evidence: Evidence) -> Outcome:
        """Diagnose an image in which the target is detected but the scheme has no measurement."""
        if evidence.measured_stamp is None:
            evidence.measured_stamp = state.stamp
        if state.stamp - evidence.measured_stamp < WINDOW:
            return Outcome("running", state.reason)
        if POINT_BEHIND_CAMERA in state.reason:
            return evidence.add_advice(make_outcome(
                "wrong_camera_model", f"the image shows the target, but {POINT_BEHIND_CAMERA} "
                "according to the calibrated mounting",
            ))  # fmt: skip
        return evidence.add_advice(make_outcome(
            "target_lost", f"no measurement since {evidence.measured_stamp:.2f} s: {state.reason}"
        ))  # fmt: skip


def _explain_loss(state: ServoState, observation: Observation, evidence: Evidence) -> Outcome:
    """Return the outcome for a lost target."""
    loss = f"the target was lost at {state.stamp:.2f} s: {state.reason}"
    unreachable = evidence.run_context.unreachable_reason
    motion, is_covered = evidence.motion_check, evidence.is_occluded
    if unreachable:
        return make_outcome("out_of_reach", f"{unreachable}; on the path there {loss}")
    if fault := motion.find_scheme_fault(state.stamp, state.phase == CONVERGED):
        return make_outcome("scheme_fault", f"{fault}; {loss}")
    is_moving = evidence.is_running_away or is_covered
    if not is_covered and (found := evidence.gain_check.explain_loss(loss)):
        return evidence.add_advice(found)
    if not is_moving and (
        fault := evidence.find_camera_fault(observation) or evidence.find_contradiction()
    ):
        kind = "scheme_fault" if motion.is_interaction_wrong else "wrong_camera_model"
        return make_outcome(kind, f"{fault}; {loss}")
    border = f" over the {evidence.last_touched_borders}" if evidence.last_touched_borders else ""
    found = make_outcome(
        "target_lost", f"target lost at {state.stamp:.2f} s{border}: {state.reason}"
    )
    if is_covered:
        return evidence.explain_occlusion(found)
    if is_moving:
        return replace(found, reason=f"{found.reason}; the camera's motion does not explain that "
                       "of the features: the target moved", remedy=KEEP_TARGET_AT_REST)  # fmt: skip
    if evidence.measured_stamp is not None and _was_inside(observation, evidence):
        found = replace(found, reason=f"{found.reason}; in the previous image, the target was far "
                                      "from the borders",
                        remedy=UNCOVER_TARGET)  # fmt: skip
    return evidence.add_advice(found)


def _was_inside(observation: Observation, evidence: Evidence) -> bool:
    """Return whether the target was too far inside the last image to have left it since then."""
    region = evidence.motion_check.area_check.next_region
    if evidence.last_touched_borders or region is None:
        return False
    camera = observation.camera
    columns, rows = camera.project(*region)
    is_inside = min(*columns, *rows) > 0.0
    return is_inside and max(columns) < camera.width and max(rows) < camera.height
