"""Policy that computes the camera's motion from images, and its training command.

    python3 -m aras_visual_servo_bench.learning.policy [--steps 12000] [--out FILE]

The image is reduced in size, and its brightness and contrast are normalised. A small network
predicts the pose of the goal in the camera's frame from it, and the policy moves the camera to this
pose. The network is trained in several rounds in the Gymnasium environment. In the first round, an
expert that knows the true pose of the goal controls the camera. In the following rounds, the policy
controls it. In all rounds, the network is trained on the images and on the true pose of the goal in
each of them.

Reference: S. Ross and others, A reduction of imitation learning and structured prediction to
no-regret online learning, AISTATS 2011 (DAgger).
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
from ..experiment.experiment import Experiment, RandomStart
from ..runner.environment import ENVIRONMENT, MAX_TWIST
from .learned_pose import relu, shrink_image
from .learned_scheme import GoalPoseNetwork, LearnedScheme, compute_errors

COLUMNS, ROWS = 40, 30  # size of the network's input image, px
TRAINING_STARTS = RandomStart(height=(0.15, 0.4), side=0.1, turn=np.radians(45.0))
# Experiment of a training episode: the simulated arm in front of the demo's target, for up to 4 s.
TRAINING_EXPERIMENT = Experiment(
    plant="bullet", start=TRAINING_STARTS, duration=4.0, time_after_convergence=None, delay=0.0
)
DAGGER_ROUNDS = 4  # number of DAgger rounds; the expert controls the camera in the first round
GAIN = 1.5  # gain of the expert and of the policy, 1/s
# Standard deviation of the noise added to the actions, whose range is -1 to 1. The noise moves the
# camera away from good paths to the goal, so that the network also learns from images there.
PERTURBATION = 0.3
# Upper bound of the random number of steps after which the noise is drawn again.
MAX_PERTURBATION_STEPS = 30
EPOCHS = 30  # number of training epochs at a learning rate of 1e-3
# Learning rate and number of epochs of each phase after the first training phase.
REFINEMENTS = ((1e-4, 15), (1e-5, 5))


def make_inputs(grey: np.ndarray) -> np.ndarray:
    """Compute the inputs (ROWS * COLUMNS,) of the network from a grey image with `shrink_image`."""
    return shrink_image(grey, COLUMNS, ROWS)


class PolicyNetwork(GoalPoseNetwork):
    """Network with ReLU layers that predicts the pose of the goal in the camera's frame."""

    user, module = "the policy", "policy"
    activation = staticmethod(relu)
    training = {
        "min_scale": 0.3, "dtype": np.float16, "refinements": REFINEMENTS,
        "hidden_layer_sizes": (192, 96), "activation": "relu", "solver": "adam", "alpha": 1e-5,
        "batch_size": 100, "learning_rate_init": 1e-3, "max_iter": EPOCHS,
        "n_iter_no_change": EPOCHS, "tol": 0.0,
    }  # fmt: skip


class Policy(LearnedScheme):
    """Scheme that moves the camera to the pose of the goal, which a network predicts from images.
    """

    needs = frozenset((Need.IMAGE,))
    tolerances = (0.0005, 0.0005, 0.0005, 0.002)
    network = PolicyNetwork

    def predict(self, observation: Observation) -> np.ndarray:
        """Return the network's prediction of the goal's pose for an observation.

        Returns:
            (4,): the goal's position x, y, z in the camera's frame, m, and its rotation about the
            optical axis, rad.

        Raises:
            MeasurementError: the observation is not valid.
        """
        if not observation.valid:
            raise MeasurementError(observation.reason or "the target is not visible")
        return self._network(make_inputs(get_grey_image(observation)))

    def teach(self, observation: Observation) -> Mapping[str, Mapping[str, Any]]:
        """Return the network's prediction for the image at the goal, as `Scheme.teach` requires."""
        return {PolicyNetwork.module: {"told": self.predict(observation).tolist()}}

    def predict_goal(self, goal: Goal) -> np.ndarray:
        """Return the prediction for the image at the goal, which is stored in the goal.

        It has the form of the result of `predict`.

        Raises:
            ConfigurationError: the goal was not taught with the policy.
        """
        prediction = np.array(
            dict(goal.features.get(PolicyNetwork.module, {})).get("told", ()), float
        )
        if prediction.shape != (4,) or not np.isfinite(prediction).all():
            raise ConfigurationError(
                f"the goal {goal.name} was not taught with the policy: teach it again with this "
                "scheme"
            )
        return prediction


def collect_demonstrations(
    policy: PolicyNetwork | None, steps: int, seed: int, environments: int
) -> tuple[np.ndarray, np.ndarray]:
    """Collect images in the environment, and the true pose of the goal for each image.

    Args:
        policy: policy that controls the camera; None for the expert.
        steps: number of images.
        seed: seed of the environments and of the noise.
        environments: number of environments that run in parallel, each in its own process.

    Returns:
        Inputs (n, ROWS * COLUMNS), from `make_inputs`; and outputs (n, 5): the goal's position in
        the camera's frame, m, and the cosine and sine of its rotation about the optical axis.
    """
    random = np.random.default_rng(seed)
    vector_environment = gymnasium.make_vec(
        ENVIRONMENT, environments, "async", experiment=TRAINING_EXPERIMENT, observes="image"
    )
    x, y = [], []
    try:
        images, info = vector_environment.reset(seed=seed)
        noise, steps_left = np.zeros((environments, 6)), np.zeros(environments, int)
        while len(x) < steps:
            inputs = [make_inputs(image) for image in images]
            camera_T_goal = info["camera_T_goal"]
            truth = np.column_stack(
                [camera_T_goal[:, :3, 3], camera_T_goal[:, 0, 0], camera_T_goal[:, 1, 0]]
            )
            x += inputs
            y += list(truth)
            turn = np.arctan2(truth[:, 4], truth[:, 3])
            goal_pose = np.column_stack([truth[:, :3], turn])
            if policy is not None:
                goal_pose = np.array([policy(row) for row in inputs])
            twist = np.zeros((environments, 6))
            twist[:, [0, 1, 2, 5]] = GAIN * goal_pose
            is_new = steps_left == 0
            steps_left[is_new] = random.integers(1, MAX_PERTURBATION_STEPS, is_new.sum())
            noise[is_new] = random.normal(0.0, PERTURBATION, (is_new.sum(), 6)) * (
                random.random() < 0.5
            )
            steps_left -= 1
            action = np.clip(twist / MAX_TWIST + noise, -1.0, 1.0).astype(np.float32)
            images, _, _, _, info = vector_environment.step(action)
    finally:
        vector_environment.close()
    return np.array(x), np.array(y)


def main(argv: list[str] | None = None) -> int:
    """Run the training command and return its exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0],
        epilog="example: python3 -m aras_visual_servo_bench.learning.policy --out policy.npz",
    )
    parser.add_argument("--steps", type=int, default=12_000, help="number of training images")
    parser.add_argument(
        "--environments", type=int, default=2 * (os.cpu_count() or 1),
        help="number of environments that run in parallel",
    )
    parser.add_argument(
        "--out", type=Path, default=PolicyNetwork.find_weights(), help="file for the weights"
    )
    options = parser.parse_args(argv)
    x, y, policy = [], [], None
    try:
        for number in range(DAGGER_ROUNDS):
            demonstrations = collect_demonstrations(
                policy, options.steps // DAGGER_ROUNDS, number, options.environments
            )
            if policy is not None:
                predicted = np.array([policy(row) for row in demonstrations[0]])
                _print_errors(number + 1, predicted, demonstrations[1])
            x.append(demonstrations[0])
            y.append(demonstrations[1])
            arrays = PolicyNetwork.train(np.concatenate(x), np.concatenate(y), number)
            policy = PolicyNetwork(arrays)
    except ExperimentError as error:
        print(f"policy: {error}", file=sys.stderr)
        return 1
    options.out.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(options.out, **arrays)
    print(f"wrote {options.out}")
    return 0


def _print_errors(number: int, predicted: np.ndarray, y: np.ndarray) -> None:
    distance, angle = (np.median(n) for n in compute_errors(predicted, y))
    print(
        f"round {number} of {DAGGER_ROUNDS}: median error on {len(y)} new images before training: "
        f"{1e3 * distance:.1f} mm, {np.degrees(angle):.2f} degrees",
        flush=True,
    )


if __name__ == "__main__":
    sys.exit(main())
