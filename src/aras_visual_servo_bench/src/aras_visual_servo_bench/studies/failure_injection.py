"""Schemes that fail on purpose, of the study `failures`."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_camera.interaction import point_interaction
from aras_visual_servo_controller.features import Feature
from aras_visual_servo_controller.features.base import FeatureMeasurement
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.observation.observation import Observation
from aras_visual_servo_controller.schemes import Scheme, SchemeOutput


class RaisingScheme(Scheme):
    """Raises at every image."""

    names, tolerances = ("nothing",), (1e-3,)

    def compute(self, observation: Observation, goal: Goal, t: float) -> SchemeOutput:
        """Never comes to an answer."""
        raise RuntimeError("broken on purpose")


class ConflictingFeature(Feature):
    """The target's centre, and a third number that is at its goal only where the centre is not."""

    name, names = "contrary", ("x", "y", "sum")
    tolerances = (1e-3, 1e-3, 1e-3)
    directions = (True, True, False, False, False, False)

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """See Feature.measure."""
        x, y = (getattr(observation.moments, k) - getattr(goal.moments, k) for k in ("xg", "yg"))
        error = np.array([x, y, x + y + 0.2])
        seen = observation.moments
        depth = goal.depth * np.sqrt(goal.moments.m00 / seen.m00)
        L = point_interaction(np.array([[seen.xg, seen.yg]]), np.array([1.0 / depth]))
        return FeatureMeasurement(error, np.zeros(3), error, np.vstack([L, L.sum(axis=0)]))


class RankDeficientFeature(ConflictingFeature):
    """The same, asked to move the camera in all directions: L lacks four ranks."""

    name = "dependent"
    directions = (True,) * 6
