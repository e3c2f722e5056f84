"""Schemes that fail on purpose, for the study `failures`."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_camera.interaction import point_interaction
from aras_visual_servo_controller.features import Feature
from aras_visual_servo_controller.features.base import FeatureMeasurement
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.observation.observation import Observation
from aras_visual_servo_controller.schemes import Scheme, SchemeOutput


class RaisingScheme(Scheme):
    """Scheme that raises an error at every image."""

    names, tolerances = ("nothing",), (1e-3,)

    def compute(self, observation: Observation, goal: Goal, t: float) -> SchemeOutput:
        """Raise a RuntimeError."""
        raise RuntimeError("broken on purpose")


class ConflictingFeature(Feature):
    """Feature whose errors cannot all be 0.

    The errors are x and y of the target's centre of gravity relative to the goal, in normalised
    image coordinates, and x + y + 0.2.
    """

    name, names = "contrary", ("x", "y", "sum")
    tolerances = (1e-3, 1e-3, 1e-3)
    directions = (True, True, False, False, False, False)

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """Measure the three errors; see Feature.measure."""
        x, y = (getattr(observation.moments, k) - getattr(goal.moments, k) for k in ("xg", "yg"))
        error = np.array([x, y, x + y + 0.2])
        moments = observation.moments
        depth = goal.depth * np.sqrt(goal.moments.m00 / moments.m00)
        L = point_interaction(np.array([[moments.xg, moments.yg]]), np.array([1.0 / depth]))
        return FeatureMeasurement(error, np.zeros(3), error, np.vstack([L, L.sum(axis=0)]))


class RankDeficientFeature(ConflictingFeature):
    """Feature that claims to control all six directions, although it controls only two.

    Its interaction matrix has rank 2.
    """

    name = "dependent"
    directions = (True,) * 6
