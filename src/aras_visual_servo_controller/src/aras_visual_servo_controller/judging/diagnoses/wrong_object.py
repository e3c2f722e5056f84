"""What is visible has another shape than the goal's target."""

from __future__ import annotations

from ...goals.goal import Goal
from ...records.outcomes import Outcome, outcome
from ...records.run_record import ImageRecord
from ...records.state import CONVERGED
from ...seeing.observation import Observation
from ..base import DIAGNOSES, RunDiagnosis
from ..evidence import Evidence
from ..shape_check import ShapeCheck


@DIAGNOSES.register("wrong_object")
class WrongObject(RunDiagnosis):
    """Compares what rotation, scale and tilt leave alone of the shape; see ShapeCheck."""

    help = "what the camera takes for the target is something else"
    reads = "moments (`shape_check.py`) and visible area of the target (`step_check.py`)"
    kinds = ("wrong_object", "wrong_camera_model", "scheme_fault")

    def __init__(self) -> None:
        self._shapes: dict[str, ShapeCheck] = {}

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """See RunDiagnosis.judge; a camera that was driven astray sees another shape too."""
        state, observation = record.state, record.observation
        if not (fault := self._strange(observation, evidence.run.goal)):
            return None
        if found := evidence.motion.scheme_fault(state.stamp, state.phase == CONVERGED):
            return outcome("scheme_fault", found)
        if found := evidence.wrong_camera(observation):
            return evidence.mistaken(found)
        return evidence.covered(outcome("wrong_object", fault))

    def _strange(self, observation: Observation, goal: Goal) -> str:
        """Why what a camera sees cannot be its goal's target, as text; empty where it can."""
        found, goals = "", goal.cameras
        for name, view in observation.cameras.items():
            check = self._shapes.get(name)
            if check is None:
                check = self._shapes[name] = ShapeCheck()
            fault = check.add(view, goals[name]) if name in goals else ""
            found = found or (f"camera {name}: {fault}" if fault and observation.others else fault)
        return found
