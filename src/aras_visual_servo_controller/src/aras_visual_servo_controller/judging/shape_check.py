"""Whether what is seen can be the goal's target."""

from __future__ import annotations

from math import atan2, hypot

from aras_visual_servo_camera.degeneracy import anisotropy, gyration_radius
from aras_visual_servo_camera.interaction import Plane

from ..goals.goal import Goal
from ..seeing.observation import Observation


class ShapeCheck:
    """Whether what is seen can be the goal's target, by two numbers that distance, place and turn
    leave alone: how spread out it is, and how long."""

    COMPACTNESS = 1.25  # ratio beyond which a tilt of 40 degrees is no excuse
    # rad, between target's normal and optical axis, beyond which the shape says nothing, and by
    # which that angle must differ from the goal's; by the canonical tasks' runs that go astray.
    TILT, TILTED = 0.7, 0.2
    ANISOTROPY = 0.3
    IMAGES = 3

    def __init__(self) -> None:
        self._strange = 0

    def add(self, observation: Observation, goal: Goal) -> str:
        """Why it cannot be the target, in words; empty where it can."""
        seen, wanted = observation.moments, goal.moments
        if seen is None or wanted is None or seen.kind != wanted.kind:
            return ""
        if self._is_tilted(observation, goal):
            self._strange = 0
            return ""
        ratio = (gyration_radius(seen) / gyration_radius(wanted)) ** 2 * wanted.m00 / seen.m00
        longer = abs(anisotropy(seen) - anisotropy(wanted))
        strange = not 1.0 / self.COMPACTNESS < ratio < self.COMPACTNESS
        strange |= longer > self.ANISOTROPY
        self._strange = self._strange + 1 if strange else 0
        if self._strange < self.IMAGES:
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
        return here > self.TILT and abs(here - there) > self.TILTED


def tilt(plane: Plane) -> float:
    """Return the angle between a plane's normal and the optical axis, rad."""
    return atan2(hypot(plane.A, plane.B), plane.C)
