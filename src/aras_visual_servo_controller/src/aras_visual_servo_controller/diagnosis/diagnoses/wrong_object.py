"""Diagnosis of a visible object whose shape differs from the goal's target."""

from __future__ import annotations

from math import atan2, hypot

from aras_visual_servo_camera.degeneracy import anisotropy, gyration_radius
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.moments import Moments

from ...goals.goal import Goal
from ...observation.observation import Observation
from ...records.outcomes import Outcome, make_outcome
from ...records.run_record import ImageRecord
from ...records.state import CONVERGED
from ..base import DIAGNOSES, DiagnosisRule
from ..evidence import Evidence


@DIAGNOSES.register("wrong_object")
class WrongObject(DiagnosisRule):
    """Comparison of the visible shape with that of the goal's target; see ShapeCheck."""

    help = "another object is detected as the target"
    reads = "moments (`wrong_object.py`) and visible area of the target (`area_check.py`)"
    kinds = ("wrong_object", "wrong_camera_model", "scheme_fault")

    def __init__(self) -> None:
        self._shapes: dict[str, ShapeCheck] = {}

    def judge(self, record: ImageRecord, evidence: Evidence) -> Outcome | None:
        """Diagnose one image, see `DiagnosisRule.judge`.

        A wrong scheme or camera model takes precedence, because a camera that moves in a wrong
        direction also changes the visible shape.
        """
        state, observation = record.state, record.observation
        fault, goals = "", evidence.run_context.goal.cameras
        for name, view in observation.cameras.items():
            check = self._shapes.get(name)
            if check is None:
                check = self._shapes[name] = ShapeCheck()
            found = check.add(view, goals[name]) if name in goals else ""
            if found and not fault:
                fault = f"camera {name}: {found}" if observation.other_cameras else found
        if not fault:
            return None
        if found := evidence.motion_check.find_scheme_fault(state.stamp, state.phase == CONVERGED):
            return make_outcome("scheme_fault", found)
        if found := evidence.find_camera_fault(observation):
            return evidence.explain_contradiction(found)
        return evidence.explain_occlusion(make_outcome("wrong_object", fault))


class ShapeCheck:
    """Test of whether a visible object can be the goal's target, by its spread and elongation.

    The spread is the squared radius of gyration divided by the area. Spread and elongation do not
    depend on the distance, position and rotation of the object in the image.
    """

    # Largest accepted ratio of the spread of the visible object to that of the goal's target, in
    # either direction. A tilt of the target by 40 degrees gives a smaller ratio.
    MAX_COMPACTNESS_RATIO = 1.25
    # The shape is not evaluated if the angle between the target's normal and the optical axis (rad)
    # exceeds MAX_TILT and differs from the angle at the goal by more than MIN_TILT_DIFFERENCE. Both
    # values are tuned on runs that diverged.
    MAX_TILT, MIN_TILT_DIFFERENCE = 0.7, 0.2
    MAX_ANISOTROPY_DIFFERENCE = 0.3
    MIN_IMAGES = 3

    def __init__(self) -> None:
        self._mismatch_count = 0
        # Of the goal: moments, spread, elongation, and angle (rad) between the target's normal and
        # the optical axis.
        self._desired: tuple[Moments | None, float, float, float] = (None, 0.0, 0.0, 0.0)

    def add(self, observation: Observation, goal: Goal) -> str:
        """Add one image and describe why the object cannot be the target; empty text if it can be.
        """
        measured, desired = observation.moments, goal.moments
        if measured is None or desired is None or measured.kind != desired.kind:
            return ""
        if self._desired[0] is not desired:
            spread = gyration_radius(desired) ** 2 / desired.m00
            there = 0.0 if goal.plane is None else tilt(goal.plane)
            self._desired = desired, spread, anisotropy(desired), there
        ratio = gyration_radius(measured) ** 2 / measured.m00 / self._desired[1]
        elongation_difference = abs(anisotropy(measured) - self._desired[2])
        is_alike = 1.0 / self.MAX_COMPACTNESS_RATIO < ratio < self.MAX_COMPACTNESS_RATIO
        is_alike &= elongation_difference <= self.MAX_ANISOTROPY_DIFFERENCE
        here = 0.0 if is_alike or observation.plane is None else tilt(observation.plane)
        is_tilted = here > self.MAX_TILT
        if is_alike or is_tilted and abs(here - self._desired[3]) > self.MIN_TILT_DIFFERENCE:
            self._mismatch_count = 0
            return ""
        self._mismatch_count += 1
        if self._mismatch_count < self.MIN_IMAGES:
            return ""
        return (
            f"the visible object is not the goal's target: its spread is {ratio:.2f} times that of "
            f"the target, and its elongation differs by {elongation_difference:.2f}"
        )


def tilt(plane: Plane) -> float:
    """Return the angle between a plane's normal and the optical axis, rad."""
    return atan2(hypot(plane.A, plane.B), plane.C)
