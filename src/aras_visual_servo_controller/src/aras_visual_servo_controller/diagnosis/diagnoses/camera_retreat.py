"""The camera goes far back from the target, as points do near half a turn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...goals.goal import Goal
from ...observation.observation import Observation
from ...records.outcomes import Outcome, make_outcome
from ...records.run_record import ImageRecord
from ...records.state import CONVERGED
from ..base import DIAGNOSES, RunDiagnosis
from ..evidence import Evidence
from ..step_check import predict_distance


@DIAGNOSES.register("camera_retreat")
class CameraRetreat(RunDiagnosis):
    """Compares the distance, by the size of the target in the image, with start and goal."""

    help = "the target appears far smaller than at the start and at the goal"
    reads = "area of the target in the image, its distance by the joints"
    kinds = ("camera_retreat", "gain_too_high")

    # Times as far as start and goal both from which on the camera has retreated, and images in a
    # row that have to show it: one may show a part of the target, or something else. Nearer than
    # RETURNED times it has come back.
    RETREAT_FACTOR, MIN_IMAGES, RETURN_FACTOR = 3.0, 3, 1.5
    # Part of the distance by the size in the image that the joints have to confirm.
    CONFIRMED_PART = 0.6

    def __init__(self) -> None:
        self._first_distance = 0.0  # distance of the target at the first image, goal's distances
        self._far_count, self._outcome = 0, Outcome()

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """See RunDiagnosis.judge; notes also what is visible of the target."""
        state, observation, goal = record.state, record.observation, evidence.run_context.goal
        for view in (observation, *observation.other_cameras.values()):
            if view.touched_borders:
                by = f" of camera {view.name}" if observation.other_cameras else ""
                evidence.last_touched_borders = f"{' and '.join(view.touched_borders)} border{by}"
        self._check_distance(state.stamp, observation, goal, evidence)
        evidence.motion_check.step_check.add_area(observation, goal)
        if self._outcome.kind == "running" or state.phase == CONVERGED:
            return None
        fault = evidence.motion_check.find_scheme_fault(state.stamp, is_converged=False)
        return make_outcome("scheme_fault", fault) if fault else evidence.add_advice(self._outcome)

    def _check_distance(
        self, stamp: float, observation: Observation, goal: Goal, evidence: Evidence
    ) -> None:
        """Whether the camera has gone far back, by how small it sees the target."""
        seen, wanted = observation.moments, goal.moments
        if not observation.valid or seen is None or wanted is None or seen.m00 <= 0.0:
            return
        distance = float(np.sqrt(wanted.m00 / seen.m00))
        self._first_distance = self._first_distance or distance
        far = distance > self.RETREAT_FACTOR * max(self._first_distance, 1.0)
        if far and goal.world_T_camera is not None and observation.world_T_camera is not None:
            by_joints = predict_distance(observation.world_T_camera, goal)
            far = by_joints > self.CONFIRMED_PART * distance
        self._far_count = self._far_count + 1 if far else 0
        if distance < self.RETURN_FACTOR * max(self._first_distance, 1.0):
            self._outcome = Outcome()
        if self._outcome.kind == "running" and self._far_count == self.MIN_IMAGES:
            words = f"the camera went back to {distance:.1f} times its goal's distance"
            self._outcome = make_outcome("camera_retreat", f"{words} from the target")
            if found := evidence.gain_check.find_recent_oscillation(stamp):
                self._outcome = replace(found, reason=f"{found.reason}; {words}")
