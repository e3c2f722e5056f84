"""Schemes with deliberate errors, and a scheme with feedforward of the target's motion."""

from __future__ import annotations

import dataclasses
import queue
import time

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
        """Never comes to an answer."""
        raise RuntimeError("broken on purpose")


class NotFinite(Feature):
    """The target's centre as NaN: a feature with a mistake in it."""

    name, names, tolerances = "not_finite", ("x", "y"), (1e-3, 1e-3)
    directions = (True, True, False, False, False, False)

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """See Feature.measure."""
        nothing = np.full(2, np.nan)
        return FeatureMeasurement(nothing, np.zeros(2), nothing, np.eye(2, 6))


class Contrary(Feature):
    """The target's centre, and a third number that is at its goal only where the centre is not."""

    name, names = "contrary", ("x", "y", "sum")
    tolerances = (1e-3, 1e-3, 1e-3)
    directions = (True, True, False, False, False, False)

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """See Feature.measure."""
        seen = observation.moments
        x, y = seen.xg - goal.moments.xg, seen.yg - goal.moments.yg
        error = np.array([x, y, x + y + 0.2])
        depth = goal.depth * np.sqrt(goal.moments.m00 / seen.m00)
        L = point_interaction(np.array([[seen.xg, seen.yg]]), np.array([1.0 / depth]))
        return FeatureMeasurement(error, np.zeros(3), error, np.vstack([L, L.sum(axis=0)]))


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

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """Points, with the rate at which the target's own motion changes them."""
        measured = super().measure(observation, goal)
        pose = observation.world_T_camera
        velocity = pose[:3, :3].T @ np.array([self.SPEED, 0.0, 0.0])
        rate = -measured.L[:, :3] @ velocity
        return dataclasses.replace(measured, error_drift=rate)


class NowAndThenNotFinite(Points):
    """Points that are NaN at one image in five."""

    name = "now_and_then_not_finite"

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """See Feature.measure."""
        measured = super().measure(observation, goal)
        if not _fails(observation):
            return measured
        return dataclasses.replace(measured, error=np.full_like(measured.error, np.nan))


class NowAndThenRaises(Points):
    """Points that raise at one image in five."""

    name = "now_and_then_raises"

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """See Feature.measure."""
        if _fails(observation):
            raise ValueError("raised on purpose")
        return super().measure(observation, goal)


class NowAndThenShorter(Points):
    """Points of which one is missing at one image in five."""

    name = "now_and_then_shorter"

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """See Feature.measure."""
        measured = super().measure(observation, goal)
        if not _fails(observation):
            return measured
        return dataclasses.replace(measured, error=measured.error[:-2])


class WrongSign(Points):
    """Points whose interaction matrix has the wrong sign."""

    name = "wrong_sign"

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """See Feature.measure."""
        measured = super().measure(observation, goal)
        return dataclasses.replace(measured, L=-measured.L)


class Constant(Points):
    """Points whose error is the same at every image."""

    name = "constant"

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """See Feature.measure."""
        measured = super().measure(observation, goal)
        return dataclasses.replace(measured, error=np.full_like(measured.error, 0.05))


class Jumping(Points):
    """Points to which a switch that chatters adds 0.3, at every third of ten images."""

    name = "jumping"

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """See Feature.measure."""
        measured = super().measure(observation, goal)
        high = int(10.0 * observation.stamp) % 3 == 0
        return dataclasses.replace(measured, error=measured.error + (0.3 if high else 0.0))


class Hanging(Points):
    """Points that are still being computed at the end of time, from 0.2 s on."""

    name = "hanging"

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """See Feature.measure."""
        while observation.stamp > 0.2:
            self.wait()
        return super().measure(observation, goal)

    def wait(self) -> None:
        """Nothing: the loop is busy."""


class Sleeping(Hanging):
    """The same, asleep again and again."""

    name = "sleeping"

    def wait(self) -> None:
        """See Hanging.wait."""
        time.sleep(0.05)


class Waiting(Hanging):
    """The same, in one call that waits for what never comes."""

    name = "waiting"

    def wait(self) -> None:
        """See Hanging.wait."""
        queue.Queue().get()


class CentreAndSize(Feature):
    """The target's centre and the logarithm of its size; subclasses misread the goal."""

    name, names = "centre_and_size", ("x", "y", "log size")
    tolerances = (1e-3, 1e-3, 1e-3)
    directions = (True, True, True, False, False, False)

    def desired(self, goal: Goal) -> np.ndarray:
        """What the goal's centre and size are taken for, (3,)."""
        return np.array([goal.moments.xg, goal.moments.yg, 0.5 * np.log(goal.moments.m00)])

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """See Feature.measure."""
        seen = observation.moments
        s = np.array([seen.xg, seen.yg, 0.5 * np.log(seen.m00)])
        wanted = self.desired(goal)
        depth = goal.depth * np.sqrt(goal.moments.m00 / seen.m00)
        L = np.vstack([
            point_interaction(np.array([[seen.xg, seen.yg]]), np.array([1.0 / depth])),
            [[0.0, 0.0, 1.0 / depth, 1.5 * seen.yg, -1.5 * seen.xg, 0.0]],
        ])  # fmt: skip
        return FeatureMeasurement(s, wanted, s - wanted, L)


class SwappedGoal(CentreAndSize):
    """x and y of the goal are swapped."""

    name = "swapped_goal"

    def desired(self, goal: Goal) -> np.ndarray:
        """See CentreAndSize.desired."""
        x, y, size = super().desired(goal)
        return np.array([y + 0.1, x - 0.1, size])


class CentredGoal(CentreAndSize):
    """The goal is taken for one 0.15 beside its own centre."""

    name = "centred_goal"

    def desired(self, goal: Goal) -> np.ndarray:
        """See CentreAndSize.desired."""
        x, y, size = super().desired(goal)
        return np.array([x + 0.15, y, size])


class SizeGoal(CentreAndSize):
    """The goal is taken for one that is a fifth larger."""

    name = "size_goal"

    def desired(self, goal: Goal) -> np.ndarray:
        """See CentreAndSize.desired."""
        x, y, size = super().desired(goal)
        return np.array([x, y, size + 0.18])


def _fails(observation: Observation) -> bool:
    """True at one image in five, on average; the same for the same stamp."""
    return int(observation.stamp * 1e6) * 2654435761 % 2**32 < 2**32 // 5
