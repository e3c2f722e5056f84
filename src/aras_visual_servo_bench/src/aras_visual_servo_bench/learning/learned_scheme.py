"""Scheme with a neural network that is trained on simulated images, and its training command.

    python3 -m aras_visual_servo_bench.learning.learned_scheme [--pictures 4000] [--out FILE]

A small network predicts the pose of the goal from the moments of an image. This pose consists of
the goal's position in the camera's frame and of the rotation about the optical axis. The scheme
moves the camera to this pose. The network's prediction for the image at the goal is subtracted, so
there is no bias at the goal.

The idea is from A. Saxena and others, Exploring convolutional networks for end-to-end visual
servoing, IEEE ICRA 2017. Their network uses images instead of moments. Training this network takes
a minute.
"""

from __future__ import annotations

import sys

import numpy as np

from aras_visual_servo_base.poses import relative_pose
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_controller.errors import ConfigurationError, MeasurementError
from aras_visual_servo_controller.features.base import wrap
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.kinematics.task import Task
from aras_visual_servo_controller.laws import Law
from aras_visual_servo_controller.observation.feature_observer import FeatureObserver, observe
from aras_visual_servo_controller.observation.observation import Need, Observation
from aras_visual_servo_controller.schemes import Scheme, SchemeOutput

from ..errors import OutOfViewError
from ..experiment.experiment import RandomStart
from .regressor import Regressor, run_training

SERVOED_DIRECTIONS = (True, True, True, False, False, True)


def make_inputs(moments: Moments) -> np.ndarray:
    """Compute the inputs (10,) of the network from moments.

    The inputs are the centre of gravity xg, yg; the logarithm of the size sqrt(m00); and the
    centred moments of order 2 and 3, divided by powers of the size so that they do not depend on
    the scale.
    """
    m00 = moments.m00
    size = np.sqrt(m00)
    second = [moments.mu(*ij) / m00**2 for ij in ((2, 0), (1, 1), (0, 2))]
    third = [
        moments.mu(*ij) / (m00**2 * size) for ij in ((3, 0), (2, 1), (1, 2), (0, 3))
    ]  # fmt: skip
    return np.array([moments.xg, moments.yg, np.log(size), *second, *third])


class GoalPoseNetwork(Regressor):
    """Network with tanh layers that predicts the pose of the goal in the camera's frame."""

    user, module = "the learned scheme", "learned"
    activation = np.tanh
    training = {
        "min_scale": 0.0, "dtype": np.float32, "hidden_layer_sizes": (64, 64),
        "activation": "tanh", "solver": "lbfgs", "alpha": 1e-6, "max_iter": 800, "max_fun": 1200,
        "tol": 1e-9,
    }  # fmt: skip

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Predict the pose of the goal from inputs (k,).

        Returns:
            (4,): the goal's position x, y, z in the camera's frame, m, and its rotation about the
            optical axis, rad.
        """
        tx, ty, tz, c, s = self.predict(x)
        return np.array([tx, ty, tz, np.arctan2(s, c)])


class LearnedScheme(Scheme):
    """Scheme that moves the camera to the pose of the goal, which a network predicts."""

    needs = frozenset((Need.MOMENTS,))
    names = ("tx", "ty", "tz", "psi")
    tolerances, units = (0.001, 0.001, 0.001, 0.005), ("m", "m", "m", "rad")
    network: type[GoalPoseNetwork] = GoalPoseNetwork

    def __init__(self, law: Law | None = None) -> None:
        super().__init__(law)
        self._network = self.network.load()
        self._goal: Goal | None = None

    def predict(self, observation: Observation) -> np.ndarray:
        """Return the network's prediction of the goal's pose for an observation.

        Returns:
            (4,): the goal's position x, y, z in the camera's frame, m, and its rotation about the
            optical axis, rad.

        Raises:
            MeasurementError: the target is not visible.
        """
        if not observation.valid or observation.moments is None:
            raise MeasurementError(observation.reason or "the target is not visible")
        return self._network(make_inputs(observation.moments))

    def predict_goal(self, goal: Goal) -> np.ndarray:
        """Return the network's prediction for the image at the goal, in the form of `predict`.

        Raises:
            ConfigurationError: the goal has no moments.
        """
        if goal.moments is None:
            raise ConfigurationError(f"the goal {goal.name} contains no moments: teach it again")
        return self._network(make_inputs(goal.moments))

    def check(self, goal: Goal) -> None:
        """Check a goal and store the prediction for its image, as required by `Scheme.check`."""
        self._goal, self._goal_prediction = goal, self.predict_goal(goal)

    def compute(self, observation: Observation, goal: Goal, t: float) -> SchemeOutput:
        """Compute features, error and twist for an observation, as `Scheme.compute` requires."""
        if self._goal is not goal:
            self.check(goal)
        prediction = self.predict(observation)
        # The error is the pose of the camera relative to the goal, while the prediction is the pose
        # of the goal relative to the camera, so the sign is opposite.
        error = self._goal_prediction - prediction
        error[3] = wrap(error[3])
        L = np.eye(6)[[0, 1, 2, 5]]
        rate = self.law.desired_error_rate(
            error, L, np.array([*error[:3], 0.0, 0.0, error[3]]), t, observation.dt
        )
        twist = np.array([*rate[:3], 0.0, 0.0, rate[3]])
        return SchemeOutput(
            self.names,
            prediction,
            self._goal_prediction,
            error,
            Task.from_twist(twist, SERVOED_DIRECTIONS),
        )


TRAINING_STARTS = RandomStart(height=(0.15, 0.5), side=0.1)


def make_training_data(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Make training data from images of the demo's target at random poses of the camera.

    Args:
        count: number n of images.
        seed: seed of the poses and of the noise in the images.

    Returns:
        Inputs (n, 10), from `make_inputs`; and outputs (n, 5): the goal's position in the camera's
        frame, m, and the cosine and sine of its rotation about the optical axis.
    """
    from ..experiment.cameras import is_in_view
    from ..experiment.experiment import Experiment
    from ..plants.imaging import capture
    from ..setup.assembly import assemble
    from ..setup.start_sampling import draw_pose

    parts = assemble(Experiment(plant="ideal", features="images", goal="2016", start="2016"))
    observer = FeatureObserver(None, frozenset((Need.MOMENTS,)))
    random, imaging = np.random.default_rng(seed), parts.plant.imaging
    shape, middle = parts.target.shape, parts.target.shape.vertices().mean(axis=0)
    x, y = [], []
    while len(x) < count:
        pose, _ = draw_pose(TRAINING_STARTS, parts.goal_pose, middle, random)
        try:
            if not is_in_view(
                shape.outline(parts.target.target_T_camera(pose)), parts.calibrated_camera, 2.0
            ):
                continue
        except OutOfViewError:
            continue
        observation = observe(
            capture(imaging, pose, 0, random), None, observer, parts.calibrated_camera
        )
        if observation.valid:
            c_T_g = relative_pose(pose, parts.goal_pose)
            x.append(make_inputs(observation.moments))
            y.append([*c_T_g[:3, 3], c_T_g[0, 0], c_T_g[1, 0]])
    return np.array(x), np.array(y)


def compute_errors(predicted: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the errors of predictions.

    Args:
        predicted: (n, 4) predictions of the network: position, m, and rotation, rad.
        y: (n, 5) true outputs, as in `make_training_data`.

    Returns:
        Position errors (n,), m, and rotation errors (n,), rad.
    """
    turn = wrap(predicted[:, 3] - np.arctan2(y[:, 4], y[:, 3]))
    return np.linalg.norm(predicted[:, :3] - y[:, :3], axis=1), np.abs(turn)


def main(argv: list[str] | None = None) -> int:
    """Run the training command and return its exit status."""
    return run_training(
        GoalPoseNetwork, argv, __doc__.splitlines()[0], 4000, 200, make_training_data,
        compute_errors,
    )  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
