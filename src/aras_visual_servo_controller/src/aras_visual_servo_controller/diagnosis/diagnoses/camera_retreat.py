"""Diagnosis of a camera retreat: the camera moves far back before it turns by about 180 degrees.

Schemes that control image points cause such a retreat.
"""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

from ...records.outcomes import Outcome, make_outcome
from ...records.run_record import ImageRecord
from ...records.state import CONVERGED
from ..area_check import predict_distance
from ..base import DIAGNOSES, DiagnosisRule
from ..evidence import Evidence


@DIAGNOSES.register("camera_retreat")
class CameraRetreat(DiagnosisRule):
    """Detection of a camera retreat from the size of the target in the image.

    This size gives the distance to the target, which is compared with the distances at the start
    and at the goal.
    """

    help = "the target appears far smaller than at the start and at the goal"
    reads = "area of the target in the image, and its distance according to the joints"
    kinds = ("camera_retreat", "gain_too_high")

    # The camera has retreated if its distance from the target exceeds RETREAT_FACTOR times the
    # distance at the start, and RETREAT_FACTOR times the distance at the goal.
    RETREAT_FACTOR = 3.0
    # A retreat is reported after this number of successive images, because a single image may show
    # only a part of the target, or a wrong object.
    MIN_IMAGES = 3
    # The camera has returned if its distance from the target is less than RETURN_FACTOR times the
    # larger of the distances at the start and at the goal.
    RETURN_FACTOR = 1.5
    # The joints confirm a retreat if the camera's distance from the target by kinematics is at
    # least this fraction of the distance by the target's size in the image.
    CONFIRMED_PART = 0.6

    def __init__(self) -> None:
        # camera's distance at the first image, relative to that at the goal
        self._first_distance = 0.0
        self._far_count, self._outcome = 0, Outcome()

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """Update the target's visible area and diagnose the image; see `DiagnosisRule.judge`."""
        state, observation, goal = record.state, record.observation, evidence.run_context.goal
        if observation.touched_borders or observation.other_cameras:
            for view in observation.cameras.values():
                if view.touched_borders:
                    by = f" of camera {view.name}" if observation.other_cameras else ""
                    borders = " and ".join(view.touched_borders)
                    evidence.last_touched_borders = f"{borders} border{by}"
        moments, desired = observation.moments, goal.moments
        if observation.valid and moments is not None and desired is not None and moments.m00 > 0.0:
            distance = sqrt(desired.m00 / moments.m00)
            self._first_distance = self._first_distance or distance
            is_far = distance > self.RETREAT_FACTOR * max(self._first_distance, 1.0)
            if is_far or self._far_count or self._outcome.kind != "running":
                self._check_distance(record, distance, is_far, evidence)
        evidence.motion_check.area_check.add(observation)
        if self._outcome.kind == "running" or state.phase == CONVERGED:
            return None
        fault = evidence.motion_check.find_scheme_fault(state.stamp, is_converged=False)
        return make_outcome("scheme_fault", fault) if fault else evidence.add_advice(self._outcome)

    def _check_distance(
        self, record: ImageRecord, distance: float, is_far: bool, evidence: Evidence
    ) -> None:
        """Determine whether the camera has retreated, or has returned from a retreat.

        According to the size of the target in the image, its distance is `distance` times the
        goal's, and `is_far` says whether a camera at this distance has retreated.
        """
        pose, goal = record.observation.world_T_camera, evidence.run_context.goal
        if is_far and goal.world_T_camera is not None and pose is not None:
            is_far = predict_distance(pose, goal) > self.CONFIRMED_PART * distance
        self._far_count = self._far_count + 1 if is_far else 0
        is_running = self._outcome.kind == "running"
        if not is_running and distance < self.RETURN_FACTOR * max(self._first_distance, 1.0):
            self._outcome, is_running = Outcome(), True
        if is_running and self._far_count == self.MIN_IMAGES:
            text = (
                f"the camera retreated to {distance:.1f} times the goal's distance from the target"
            )
            self._outcome = make_outcome("camera_retreat", text)
            if found := evidence.gain_check.find_recent_oscillation(record.state.stamp):
                self._outcome = replace(found, reason=f"{found.reason}; {text}")
