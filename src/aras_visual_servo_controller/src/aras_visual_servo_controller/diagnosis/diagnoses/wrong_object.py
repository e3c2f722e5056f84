"""What is visible has another shape than the goal's target."""

from __future__ import annotations

from math import atan2, hypot

from aras_visual_servo_camera.degeneracy import anisotropy, gyration_radius
from aras_visual_servo_camera.interaction import Plane

from ...goals.goal import Goal
from ...observation.observation import Observation
from ...records.outcomes import Outcome, make_outcome
from ...records.run_record import ImageRecord
from ...records.state import CONVERGED
from ..base import DIAGNOSES, RunDiagnosis
from ..evidence import Evidence


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
        if not (fault := self._explain_mismatch(observation, evidence.run_context.goal)):
            return None
        if found := evidence.motion_check.find_scheme_fault(state.stamp, state.phase == CONVERGED):
            return make_outcome("scheme_fault", found)
        if found := evidence.find_camera_fault(observation):
            return evidence.explain_contradiction(found)
        return evidence.explain_occlusion(make_outcome("wrong_object", fault))

    def _explain_mismatch(self, observation: Observation, goal: Goal) -> str:
        """Why what a camera sees cannot be its goal's target, as text; empty where it can."""
        found, goals = "", goal.cameras
        for name, view in observation.cameras.items():
            check = self._shapes.get(name)
            if check is None:
                check = self._shapes[name] = ShapeCheck()
            fault = check.add(view, goals[name]) if name in goals else ""
            found = found or (
                f"camera {name}: {fault}" if fault and observation.other_cameras else fault
            )
        return found


class ShapeCheck:
    """Whether what is seen can be the goal's target, by two numbers that distance, place and turn
    leave alone: how spread out it is, and how long."""

    MAX_COMPACTNESS_RATIO = 1.25  # ratio beyond which a tilt of 40 degrees is no excuse
    # rad, between target's normal and optical axis, beyond which the shape says nothing, and by
    # which that angle must differ from the goal's; by the canonical tasks' runs that go astray.
    MAX_TILT, MIN_TILT_DIFFERENCE = 0.7, 0.2
    MAX_ANISOTROPY_DIFFERENCE = 0.3
    MIN_IMAGES = 3

    def __init__(self) -> None:
        self._mismatch_count = 0

    def add(self, observation: Observation, goal: Goal) -> str:
        """Why it cannot be the target, in words; empty where it can."""
        seen, wanted = observation.moments, goal.moments
        if seen is None or wanted is None or seen.kind != wanted.kind:
            return ""
        if self._is_tilted(observation, goal):
            self._mismatch_count = 0
            return ""
        ratio = (gyration_radius(seen) / gyration_radius(wanted)) ** 2 * wanted.m00 / seen.m00
        longer = abs(anisotropy(seen) - anisotropy(wanted))
        strange = not 1.0 / self.MAX_COMPACTNESS_RATIO < ratio < self.MAX_COMPACTNESS_RATIO
        strange |= longer > self.MAX_ANISOTROPY_DIFFERENCE
        self._mismatch_count = self._mismatch_count + 1 if strange else 0
        if self._mismatch_count < self.MIN_IMAGES:
            return ""
        return (
            f"what is seen is not the goal's target: {ratio:.2f} times as spread out, its "
            f"length differs by {longer:.2f}"
        )

    def _is_tilted(self, observation: Observation, goal: Goal) -> bool:
        """Whether the camera looks at the target from far more aside than at the goal."""
        if observation.plane is None:
            return False
        here = tilt(observation.plane)
        there = 0.0 if goal.plane is None else tilt(goal.plane)
        return here > self.MAX_TILT and abs(here - there) > self.MIN_TILT_DIFFERENCE


def tilt(plane: Plane) -> float:
    """Return the angle between a plane's normal and the optical axis, rad."""
    return atan2(hypot(plane.A, plane.B), plane.C)
