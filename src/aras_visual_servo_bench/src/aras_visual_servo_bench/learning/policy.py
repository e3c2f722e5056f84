"""A policy that sees pictures, and what teaches it in the environment.

    python3 -m aras_visual_servo_bench.learning.policy [--steps 12000] [--out FILE]

The picture, made small and free of brightness and contrast, goes through a small network, which
tells where the goal is in the camera's frame; the camera flies there. It learns from a teacher that
knows: the teacher flies first, then the policy itself, and in every picture on the way it is told
where the goal truly was. Reference: S. Ross and others, A reduction of imitation learning and
structured prediction to no-regret online learning, AISTATS 2011 (DAgger).
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from aras_visual_servo_controller.errors import ConfigurationError, MeasurementError
from aras_visual_servo_controller.features.luminance import get_grey_image
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.observation.observation import Need, Observation

from ..errors import ExperimentError
from ..experiment.experiment import Experiment, Sampler
from ..runner.environment import ENVIRONMENT, MAX_TWIST
from .learned import GoalPoseNetwork, LearnedScheme, compute_errors
from .learned_pose import relu, shrink_image
from .regressor import fit_network

COLUMNS, ROWS = 40, 30  # of the picture that the network sees
HIDDEN_LAYERS = (192, 96)
TRAINING_STARTS = Sampler(height=(0.15, 0.4), side=0.1, turn=np.radians(45.0))
# The arm before the demo's target, as on the graph; episodes of up to 4 s.
TRAINING_EXPERIMENT = Experiment(
    plant="bullet", start=TRAINING_STARTS, duration=4.0, time_after_convergence=None, delay=0.0
)
DAGGER_ROUNDS = 4  # the teacher flies in the first one, the policy in the others
GAIN = 1.5  # 1/s, of both
PERTURBATION = 0.3  # deviation of what is added to an action, so that more is seen than good ways
MAX_PERTURBATION_STEPS = 30  # steps that such an addition lasts, at most
EPOCHS, REFINEMENTS = 30, ((1e-4, 15), (1e-5, 5))  # at a rate of 1e-3, and at lower ones


def make_inputs(grey: np.ndarray) -> np.ndarray:
    """A picture (rows, columns) uint8 as (ROWS * COLUMNS,) numbers of mean 0 and deviation 1."""
    return shrink_image(grey, COLUMNS, ROWS)


class PolicyNetwork(GoalPoseNetwork):
    """Rectified layers; see Regressor for its arrays."""

    user, module = "the policy", "policy"
    activation = staticmethod(relu)


class Policy(LearnedScheme):
    """Flies as the network tells by the picture; see Learned."""

    needs = frozenset((Need.IMAGE,))
    tolerances = (0.0005, 0.0005, 0.0005, 0.002)
    network = PolicyNetwork

    def predict(self, observation: Observation) -> np.ndarray:
        """See Learned.told."""
        if not observation.valid:
            raise MeasurementError(observation.reason or "the target is not visible")
        return self._network(make_inputs(get_grey_image(observation)))

    def teach(self, observation: Observation) -> Mapping[str, Mapping[str, Any]]:
        """See Scheme.teach: what the network tells of the goal's picture."""
        return {PolicyNetwork.module: {"told": self.predict(observation).tolist()}}

    def predict_goal(self, goal: Goal) -> np.ndarray:
        """See Learned.told_of_goal."""
        told = np.array(dict(goal.features.get(PolicyNetwork.module, {})).get("told", ()), float)
        if told.shape != (4,) or not np.isfinite(told).all():
            raise ConfigurationError(f"{goal.name} was not shown to the policy: teach it anew")
        return told


def collect_demonstrations(
    policy: PolicyNetwork | None, steps: int, seed: int, environments: int
) -> tuple[np.ndarray, np.ndarray]:
    """Pictures met in the environment, and where the goal was in each.

    Args:
        policy: that flies; None: the teacher does.
        steps: pictures wanted. environments: that are stepped at once, each in a process.

    Returns:
        Inputs (n, ROWS * COLUMNS) and answers (n, 5): the goal's place in the camera's frame, m,
        and cosine and sine of its turn.
    """
    random = np.random.default_rng(seed)
    flown = gymnasium.make_vec(
        ENVIRONMENT, environments, "async", experiment=TRAINING_EXPERIMENT, observes="image"
    )
    x, y = [], []
    try:
        pictures, info = flown.reset(seed=seed)
        astray, left = np.zeros((environments, 6)), np.zeros(environments, int)
        while len(x) < steps:
            seen = [make_inputs(picture) for picture in pictures]
            found = info["camera_T_goal"]
            truth = np.column_stack([found[:, :3, 3], found[:, 0, 0], found[:, 1, 0]])
            x += seen
            y += list(truth)
            turn = np.arctan2(truth[:, 4], truth[:, 3])
            told = np.column_stack([truth[:, :3], turn])
            if policy is not None:
                told = np.array([policy(one) for one in seen])
            asked = np.zeros((environments, 6))
            asked[:, [0, 1, 2, 5]] = GAIN * told
            new = left == 0
            left[new] = random.integers(1, MAX_PERTURBATION_STEPS, new.sum())
            astray[new] = random.normal(0.0, PERTURBATION, (new.sum(), 6)) * (random.random() < 0.5)
            left -= 1
            action = np.clip(asked / MAX_TWIST + astray, -1.0, 1.0).astype(np.float32)
            pictures, _, _, _, info = flown.step(action)
    finally:
        flown.close()
    return np.array(x), np.array(y)


def train(x: np.ndarray, y: np.ndarray, seed: int = 0) -> dict[str, np.ndarray]:
    """Arrays of a PolicyNetwork that answers y (n, 5) to x (n, k); ExperimentError: no library."""
    return fit_network(
        x, y, 0.3, np.float16, REFINEMENTS, hidden_layer_sizes=HIDDEN_LAYERS, activation="relu",
        solver="adam",
        alpha=1e-5, batch_size=100, learning_rate_init=1e-3, max_iter=EPOCHS, tol=0.0,
        n_iter_no_change=EPOCHS, random_state=seed,
    )  # fmt: skip


def main(argv: list[str] | None = None) -> int:
    """Teach the policy; returns the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0],
        epilog="example: python3 -m aras_visual_servo_bench.learning.policy --out policy.npz",
    )
    parser.add_argument("--steps", type=int, default=12_000, help="pictures to learn from")
    parser.add_argument("--environments", type=int, default=2 * (os.cpu_count() or 1))
    parser.add_argument("--out", type=Path, default=PolicyNetwork.find_weights())
    options = parser.parse_args(argv)
    x, y, policy = [], [], None
    try:
        for number in range(DAGGER_ROUNDS):
            met = collect_demonstrations(
                policy, options.steps // DAGGER_ROUNDS, number, options.environments
            )
            if policy is not None:
                found = np.array([policy(row) for row in met[0]])
                _print_errors(number + 1, found, met[1])
            x.append(met[0])
            y.append(met[1])
            arrays = train(np.concatenate(x), np.concatenate(y), number)
            policy = PolicyNetwork(arrays)
    except ExperimentError as error:
        print(f"policy: {error}", file=sys.stderr)
        return 1
    options.out.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(options.out, **arrays)
    print(f"wrote {options.out}")
    return 0


def _print_errors(number: int, predicted: np.ndarray, y: np.ndarray) -> None:
    far, turn = (np.median(n) for n in compute_errors(predicted, y))
    print(f"round {number} of {DAGGER_ROUNDS}: before, it told half of {len(y)} unseen pictures "
          "within "
          f"{1e3 * far:.1f} mm and {np.degrees(turn):.2f} degrees", flush=True)  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
