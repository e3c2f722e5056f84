"""The scheme has no answer to an image: the target is lost, or cannot be measured."""

from __future__ import annotations

from dataclasses import replace

from ...errors import BEHIND
from ...records.outcomes import NO_MOTION, UNCOVERED, Outcome, outcome
from ...records.run_record import ImageRecord
from ...records.state import CONVERGED, HOLDING, ServoState
from ...seeing.observation import Observation
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
        if state.decision is not None:
            evidence.measured, self._loss = state.stamp, None
            return None
        if state.phase != HOLDING:
            return Outcome("running", state.reason)  # what was before is over
        if observation.valid:
            return self._unanswered(state, evidence)
        # However long ago: what was swinging when it was lost, was lost by that.
        measured = evidence.measured
        if measured is not None and (found := evidence.gain.lately(measured)):
            return evidence.advised(found)
        if self._loss is None:
            seen_wrong = evidence.present.kind == "wrong_object"
            self._loss = evidence.present if seen_wrong else _lost(state, observation, evidence)
        return self._loss

    def _unanswered(self, state: ServoState, evidence: Evidence) -> Outcome:
        """Of an image in which the target is seen and the scheme finds no answer."""
        if evidence.measured is None:
            evidence.measured = state.stamp
        if state.stamp - evidence.measured < WINDOW:
            return Outcome("running", state.reason)
        if BEHIND in state.reason:
            return evidence.advised(outcome(
                "wrong_camera_model", f"the image shows the target, but {BEHIND} where that is "
                "believed to be mounted",
            ))  # fmt: skip
        return evidence.advised(outcome(
            "target_lost", f"no measurement since {evidence.measured:.2f} s: {state.reason}"
        ))  # fmt: skip


def _lost(state: ServoState, observation: Observation, evidence: Evidence) -> Outcome:
    """Why the target was lost."""
    at = f"the target was lost at {state.stamp:.2f} s: {state.reason}"
    beyond, motion, covered = evidence.run.beyond, evidence.motion, evidence.is_covered
    if beyond:
        return outcome("out_of_reach", f"{beyond}; before it came there {at}")
    if fault := motion.scheme_fault(state.stamp, state.phase == CONVERGED):
        return outcome("scheme_fault", f"{fault}; {at}")
    moves = evidence.is_running_away or covered
    if not covered and (found := evidence.gain.lost(at)):
        return evidence.advised(found)
    if not moves and (fault := evidence.wrong_camera(observation) or evidence.contrary()):
        kind = "scheme_fault" if motion.l_is_wrong else "wrong_camera_model"
        return outcome(kind, f"{fault}; {at}")
    over = f" over the {evidence.touched}" if evidence.touched else ""
    found = outcome("target_lost", f"target lost at {state.stamp:.2f} s{over}: {state.reason}")
    if covered:
        return evidence.covered(found)
    if moves:
        return replace(found, reason=f"{found.reason}; the features moved otherwise than the "
                       "camera: the target moved", remedy=NO_MOTION)  # fmt: skip
    if evidence.measured is not None and _was_inside(observation, evidence):
        found = replace(found, reason=f"{found.reason}; it was inside of the image before",
                        remedy=UNCOVERED)  # fmt: skip
    return evidence.advised(found)


def _was_inside(observation: Observation, evidence: Evidence) -> bool:
    """Whether the target cannot have left the image by the motion that it had in it."""
    following = evidence.motion.steps.next
    if evidence.touched or following is None:
        return False
    camera = observation.camera
    columns, rows = camera.project(*following)
    inside = min(*columns, *rows) > 0.0
    return inside and max(columns) < camera.width and max(rows) < camera.height
