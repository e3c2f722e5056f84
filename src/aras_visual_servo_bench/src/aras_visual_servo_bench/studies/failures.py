"""Provokes failures, and sees whether the loop names them.

    python3 -m aras_visual_servo_bench.studies.failures [--seeds 5] [--only gain_too_high]
"""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any

import numpy as np

from aras_visual_servo_controller.features import Feature
from aras_visual_servo_controller.features.base import Measured
from aras_visual_servo_controller.features.points import point_interaction
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.schemes import Decision, Scheme
from aras_visual_servo_controller.seeing.observation import Observation

from ..asked.experiment import Experiment
from ..running.loop import run

NEAR = {"height": [0.2, 0.32], "side": 0.05, "turn": 0.8}
BASE: dict[str, Any] = {"plant": "chain", "start": NEAR, "duration": 8.0, "linger": 0.3}
LEAVING = {"motion": {"velocity": [1.5, 0.8, 0.0, 0.0, 0.0, 0.0], "begin": 0.4}}
LONG = [[-0.06, -0.008], [0.06, -0.008], [0.06, 0.008], [-0.06, 0.02]]
ON_TABLE = [0.0, 0.0, 0.59, 0.0, 0.0, 0.0]


class Broken(Scheme):
    """Raises at every image."""

    names, tolerances = ("nothing",), (1e-3,)

    def compute(self, observation: Observation, goal: Goal, t: float) -> Decision:
        """Never comes to an answer."""
        raise RuntimeError("broken on purpose")


class Contrary(Feature):
    """The target's centre, and a third number that is at its goal only where the centre is not."""

    name, names = "contrary", ("x", "y", "sum")
    tolerances = (1e-3, 1e-3, 1e-3)
    directions = (True, True, False, False, False, False)

    def measure(self, observation: Observation, goal: Goal) -> Measured:
        """See Feature.measure."""
        x, y = (getattr(observation.moments, k) - getattr(goal.moments, k) for k in ("xg", "yg"))
        error = np.array([x, y, x + y + 0.2])
        seen = observation.moments
        depth = goal.depth * np.sqrt(goal.moments.m00 / seen.m00)
        L = point_interaction(np.array([[seen.xg, seen.yg]]), np.array([1.0 / depth]))
        return Measured(error, np.zeros(3), error, np.vstack([L, L.sum(axis=0)]))


class Dependent(Contrary):
    """The same, asked to move the camera in all directions: L lacks four ranks."""

    name = "dependent"
    directions = (True,) * 6


# What is provoked, and how: changes of BASE.
FAILURES: dict[str, dict[str, Any]] = {
    "target_lost": {"target": LEAVING},
    "singular": {"scheme": f"{__name__}:Dependent"},
    "out_of_reach": {"goal": {"pose": [0.0, 0.0, 0.70, 3.141592653589793, 0.0, 0.0]}},
    "joint_limit": {"options": {"upper": {"gantry": -0.1}}, "start": {
        "height": [0.2, 0.32], "side": 0.02, "turn": 0.8}},
    "saturation": {"options": {"max_velocity": 0.01}},
    "gain_too_high": {"gain": 45.0},
    "too_few_images": {"gain": 1.0, "camera": {
        "horizontal_fov": 2.0, "effects": {"drop_probability": 0.96}}},
    "wrong_camera_model": {"believed": {"focal": 1.6}, "features": "pictures"},
    "wrong_object": {"target": {"shape": LONG, "pose": ON_TABLE}, "goal": "2016"},
    "scheme_fault": {"scheme": f"{__name__}:Broken"},
    "timed_out": {"gain": 0.15, "duration": 4.0},
    "local_minimum": {"scheme": f"{__name__}:Contrary"},
}  # fmt: skip


def provoke(failure: str, seed: int) -> tuple[str, str]:
    """Outcome and reason of one provoked failure."""
    result = run(Experiment.from_mapping({**BASE, **FAILURES[failure], "seed": seed}))
    return result.outcome, f"{result.verdict.word} {result.reason}"


def main(argv: list[str] | None = None) -> int:
    """Print a line for each run, and the counts as the last line, JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--only", default="", choices=["", *FAILURES])
    options = parser.parse_args(argv)
    right, total = {}, 0
    for failure in [options.only] if options.only else FAILURES:
        right[failure] = 0
        for seed in range(options.seeds):
            outcome, reason = provoke(failure, seed)
            right[failure] += outcome == failure
            total += 1
            print(f"{failure} {seed}: {outcome} ({reason})", flush=True)
    print(json.dumps({**right, "runs": total, "right": sum(right.values())}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
