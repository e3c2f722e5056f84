"""The camera goes far back from the target, as points do near half a turn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...goals.goal import Goal
from ...records.outcomes import Outcome, outcome
from ...records.run_record import ImageRecord
from ...records.state import CONVERGED
from ...seeing.observation import Observation
from ..base import DIAGNOSES, RunDiagnosis
from ..evidence import Evidence
from ..step_check import distance_by_kinematics


@DIAGNOSES.register("camera_retreat")
class CameraRetreat(RunDiagnosis):
    """Compares the distance, by the size of the target in the image, with start and goal."""

    help = "the target appears far smaller than at the start and at the goal"
    reads = "area of the target in the image, its distance by the joints"
    kinds = ("camera_retreat", "gain_too_high")

    # Times as far as start and goal both from which on the camera has retreated, and images in a
    # row that have to show it: one may show a part of the target, or something else. Nearer than
    # RETURNED times it has come back.
    RETREAT, IN_A_ROW, RETURNED = 3.0, 3, 1.5
    # Part of the distance by the size in the image that the joints have to confirm.
    CONFIRMED = 0.6

    def __init__(self) -> None:
        self._first = 0.0  # distance of the target at the first image, goal's distances
        self._far, self._found = 0, Outcome()

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """See RunDiagnosis.judge; notes also what is visible of the target."""
        state, observation, goal = record.state, record.observation, evidence.run.goal
        for view in (observation, *observation.others.values()):
            if view.touches:
                by = f" of camera {view.name}" if observation.others else ""
                evidence.touched = f"{' and '.join(view.touches)} border{by}"
        self._follow(state.stamp, observation, goal, evidence)
        evidence.motion.steps.follow_area(observation, goal)
        if self._found.kind == "running" or state.phase == CONVERGED:
            return None
        fault = evidence.motion.scheme_fault(state.stamp, converged=False)
        return outcome("scheme_fault", fault) if fault else evidence.advised(self._found)

    def _follow(
        self, stamp: float, observation: Observation, goal: Goal, evidence: Evidence
    ) -> None:
        """Whether the camera has gone far back, by how small it sees the target."""
        seen, wanted = observation.moments, goal.moments
        if not observation.valid or seen is None or wanted is None or seen.m00 <= 0.0:
            return
        distance = float(np.sqrt(wanted.m00 / seen.m00))
        self._first = self._first or distance
        far = distance > self.RETREAT * max(self._first, 1.0)
        if far and goal.world_T_camera is not None and observation.world_T_camera is not None:
            by_joints = distance_by_kinematics(observation.world_T_camera, goal)
            far = by_joints > self.CONFIRMED * distance
        self._far = self._far + 1 if far else 0
        if distance < self.RETURNED * max(self._first, 1.0):
            self._found = Outcome()
        if self._found.kind == "running" and self._far == self.IN_A_ROW:
            words = f"the camera went back to {distance:.1f} times its goal's distance"
            self._found = outcome("camera_retreat", f"{words} from the target")
            if found := evidence.gain.lately(stamp):
                self._found = replace(found, reason=f"{found.reason}; {words}")
