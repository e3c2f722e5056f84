"""Schemes with deliberate errors, and a scheme with feedforward of the target's motion."""

from __future__ import annotations

import queue
import re
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from aras_visual_servo_camera.interaction import point_interaction
from aras_visual_servo_controller.features import Feature, FeatureMeasurement
from aras_visual_servo_controller.features.points import Points
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.observation.observation import Observation
from aras_visual_servo_controller.schemes import Scheme, SchemeOutput


class Broken(Scheme):
    """Raises from the third image on."""

    names, tolerances = ("nothing",), (1e-3,)

    def __init__(self, law: object = None) -> None:
        self._images = 0

    def compute(self, observation: Observation, goal: Goal, t: float) -> SchemeOutput:
        raise RuntimeError("broken on purpose")


class NotFinite(Feature):
    """The target's centre as NaN: a feature with a mistake in it."""

    name, names, tolerances = "not_finite", ("x", "y"), (1e-3, 1e-3)
    directions = (True, True, False, False, False, False)

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        nothing = np.full(2, np.nan)
        return FeatureMeasurement(nothing, np.zeros(2), nothing, np.eye(2, 6))


def _centre_rows(observation: Observation, goal: Goal) -> tuple[float, np.ndarray]:
    """Depth (m) of the target, and rows (2, 6) of L of its centre."""
    seen = observation.moments
    depth = goal.depth * np.sqrt(goal.moments.m00 / seen.m00)
    return depth, point_interaction(np.array([[seen.xg, seen.yg]]), np.array([1.0 / depth]))


class Contrary(Feature):
    """The target's centre, and a third number that is at its goal only where the centre is not."""

    name, names = "contrary", ("x", "y", "sum")
    tolerances = (1e-3, 1e-3, 1e-3)
    directions = (True, True, False, False, False, False)

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        seen, (_, L) = observation.moments, _centre_rows(observation, goal)
        x, y = seen.xg - goal.moments.xg, seen.yg - goal.moments.yg
        error = np.array([x, y, x + y + 0.2])
        return FeatureMeasurement(error, np.zeros(3), error, np.vstack([L, L.sum(axis=0)]))


class Dependent(Contrary):
    """The same, asked to move the camera in all directions: L lacks four ranks."""

    name = "dependent"
    directions = (True,) * 6


class Altered(Points):
    """Points whose measurement is changed by `alter`."""

    alter: Callable[..., FeatureMeasurement]

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        return self.alter(super().measure(observation, goal), observation)


def altered(alter: Callable[..., FeatureMeasurement]) -> type[Altered]:
    """Make a feature of a function that changes the measurement of points."""
    name = re.sub("(?<=.)([A-Z])", r"_\1", alter.__name__).lower()
    members = {"__doc__": alter.__doc__, "name": name, "alter": staticmethod(alter)}
    return type(alter.__name__, (Altered,), members)


@altered
def Following(measured, observation):
    """Points of a target whose velocity is known: 30 mm/s along the world's x.

    The camera's own axes at the goals of this campaign: x along the world's x.
    """
    velocity = observation.world_T_camera[:3, :3].T @ np.array([0.03, 0.0, 0.0])
    return replace(measured, error_drift=-measured.L[:, :3] @ velocity)


def _fails(observation: Observation) -> bool:
    """True at one image in five, on average; the same for the same stamp."""
    return int(observation.stamp * 1e6) * 2654435761 % 2**32 < 2**32 // 5


@altered
def NowAndThenNotFinite(measured, observation):
    """Points that are NaN at one image in five."""
    nothing = np.full_like(measured.error, np.nan)
    return replace(measured, error=nothing) if _fails(observation) else measured


@altered
def NowAndThenRaises(measured, observation):
    """Points that raise at one image in five."""
    if _fails(observation):
        raise ValueError("raised on purpose")
    return measured


@altered
def NowAndThenShorter(measured, observation):
    """Points of which one is missing at one image in five."""
    return replace(measured, error=measured.error[:-2]) if _fails(observation) else measured


@altered
def WrongSign(measured, observation):
    """Points whose interaction matrix has the wrong sign."""
    return replace(measured, L=-measured.L)


@altered
def Constant(measured, observation):
    """Points whose error is the same at every image."""
    return replace(measured, error=np.full_like(measured.error, 0.05))


@altered
def Jumping(measured, observation):
    """Points to which a switch that chatters adds 0.3, at every third of ten images."""
    high = int(10.0 * observation.stamp) % 3 == 0
    return replace(measured, error=measured.error + (0.3 if high else 0.0))


class Hanging(Points):
    """Points that are still being computed at the end of time, from 0.2 s on: the loop is busy."""

    name, wait = "hanging", staticmethod(lambda: None)

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        while observation.stamp > 0.2:
            self.wait()
        return super().measure(observation, goal)


class Sleeping(Hanging):
    """The same, asleep again and again."""

    name, wait = "sleeping", staticmethod(lambda: time.sleep(0.05))


class Waiting(Hanging):
    """The same, in one call that waits for what never comes."""

    name, wait = "waiting", staticmethod(lambda: queue.Queue().get())


class CentreAndSize(Feature):
    """The target's centre and the logarithm of its size; subclasses misread those of the goal."""

    name, names = "centre_and_size", ("x", "y", "log size")
    tolerances = (1e-3, 1e-3, 1e-3)
    directions = (True, True, True, False, False, False)
    misread: Callable[[float, float, float], tuple[float, float, float]]

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        s, at_goal = (np.array([m.xg, m.yg, 0.5 * np.log(m.m00)])
                      for m in (observation.moments, goal.moments))  # fmt: skip
        wanted = np.array(self.misread(*at_goal))
        depth, L = _centre_rows(observation, goal)
        growth = [0.0, 0.0, 1.0 / depth, 1.5 * s[1], -1.5 * s[0], 0.0]
        return FeatureMeasurement(s, wanted, s - wanted, np.vstack([L, growth]))


class SwappedGoal(CentreAndSize):
    """x and y of the goal are swapped."""

    name, misread = "swapped_goal", staticmethod(lambda x, y, size: (y + 0.1, x - 0.1, size))


class CentredGoal(CentreAndSize):
    """The goal is taken for one 0.15 beside its own centre."""

    name, misread = "centred_goal", staticmethod(lambda x, y, size: (x + 0.15, y, size))


class SizeGoal(CentreAndSize):
    """The goal is taken for one that is a fifth larger."""

    name, misread = "size_goal", staticmethod(lambda x, y, size: (x, y, size + 0.18))
