"""Schemes that are wrong on purpose, and one that feeds its target's motion forward."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_controller.features import Feature, Measured
from aras_visual_servo_controller.features.points import Points, point_interaction
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.schemes import Decision, Scheme
from aras_visual_servo_controller.seeing.observation import Observation


class Broken(Scheme):
    """Raises from the third image on."""

    names, tolerances = ("nothing",), (1e-3,)

    def __init__(self, law: object = None) -> None:
        self._images = 0

    def compute(self, observation: Observation, goal: Goal, t: float) -> Decision:
        """Never comes to an answer."""
        raise RuntimeError("broken on purpose")


class NotFinite(Feature):
    """The target's centre as NaN: a feature with a mistake in it."""

    name, names, tolerances = "not_finite", ("x", "y"), (1e-3, 1e-3)
    directions = (True, True, False, False, False, False)

    def measure(self, observation: Observation, goal: Goal) -> Measured:
        """See Feature.measure."""
        nothing = np.full(2, np.nan)
        return Measured(nothing, np.zeros(2), nothing, np.eye(2, 6))


class Contrary(Feature):
    """The target's centre, and a third number that is at its goal only where the centre is not."""

    name, names = "contrary", ("x", "y", "sum")
    tolerances = (1e-3, 1e-3, 1e-3)
    directions = (True, True, False, False, False, False)

    def measure(self, observation: Observation, goal: Goal) -> Measured:
        """See Feature.measure."""
        seen = observation.moments
        x, y = seen.xg - goal.moments.xg, seen.yg - goal.moments.yg
        error = np.array([x, y, x + y + 0.2])
        depth = goal.depth * np.sqrt(goal.moments.m00 / seen.m00)
        L = point_interaction(np.array([[seen.xg, seen.yg]]), np.array([1.0 / depth]))
        return Measured(error, np.zeros(3), error, np.vstack([L, L.sum(axis=0)]))


class Dependent(Contrary):
    """The same, asked to move the camera in all directions: L lacks four ranks."""

    name = "dependent"
    directions = (True,) * 6


class Following(Points):
    """Points of a target whose velocity is known: 30 mm/s along the world's x.

    The camera's own axes at the goals of this campaign: x along the world's x.
    """

    name = "following"
    SPEED = 0.03

    def measure(self, observation: Observation, goal: Goal) -> Measured:
        """Points, with the rate at which the target's own motion changes them."""
        import dataclasses

        measured = super().measure(observation, goal)
        pose = observation.world_T_camera
        velocity = pose[:3, :3].T @ np.array([self.SPEED, 0.0, 0.0])
        rate = -measured.L[:, :3] @ velocity
        return dataclasses.replace(measured, rate=rate)
