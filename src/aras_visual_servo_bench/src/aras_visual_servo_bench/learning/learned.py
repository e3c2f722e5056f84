"""A scheme whose network was taught by the simulator's own pictures, and what teaches it.

    python3 -m aras_visual_servo_bench.learning.learned [--pictures 4000] [--out FILE]

From the moments of a picture, made free of their units, a small network tells where the goal is in
the camera's frame and by how much it is turned; the camera flies there. What it tells of the
goal's own picture is taken off, so that its bias at the goal is none. Reference: A. Saxena and
others, Exploring convolutional networks for end-to-end visual servoing, IEEE ICRA 2017, for the
idea; ours sees moments, and learns in a minute.
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

from ..errors import ViewError
from ..experiment.experiment import Sampler
from .regressor import Regressor, fit_network, run_training

SERVOED_DIRECTIONS = (True, True, True, False, False, True)
HIDDEN_LAYERS = (64, 64)


def make_inputs(moments: Moments) -> np.ndarray:
    """Numbers (10,) of a picture: place, size, and shape with its direction, free of scale."""
    m00 = moments.m00
    size = np.sqrt(m00)
    second = [moments.mu(*ij) / m00**2 for ij in ((2, 0), (1, 1), (0, 2))]
    third = [
        moments.mu(*ij) / (m00**2 * size) for ij in ((3, 0), (2, 1), (1, 2), (0, 3))
    ]  # fmt: skip
    return np.array([moments.xg, moments.yg, np.log(size), *second, *third])


class GoalPoseNetwork(Regressor):
    """Layers of tanh; see Regressor for its arrays."""

    user, module = "the learned scheme", "learned"
    activation = np.tanh

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Place of the goal in the camera's frame (3), m, and its turn, rad: (4,)."""
        tx, ty, tz, c, s = self.predict(x)
        return np.array([tx, ty, tz, np.arctan2(s, c)])


class LearnedScheme(Scheme):
    """Flies to where the network says that the goal is."""

    needs = frozenset((Need.MOMENTS,))
    names = ("tx", "ty", "tz", "psi")
    tolerances, units = (0.001, 0.001, 0.001, 0.005), ("m", "m", "m", "rad")
    network: type[GoalPoseNetwork] = GoalPoseNetwork

    def __init__(self, law: Law | None = None) -> None:
        super().__init__(law)
        self._network = self.network.load()
        self._goal: Goal | None = None

    def predict(self, observation: Observation) -> np.ndarray:
        """What the network tells (4,) of what is seen; MeasurementError where nothing is."""
        if not observation.valid or observation.moments is None:
            raise MeasurementError(observation.reason or "the target is not visible")
        return self._network(make_inputs(observation.moments))

    def predict_goal(self, goal: Goal) -> np.ndarray:
        """The same of the goal; ConfigurationError where it does not hold it."""
        if goal.moments is None:
            raise ConfigurationError(f"{goal.name} holds no moments: teach it anew")
        return self._network(make_inputs(goal.moments))

    def check(self, goal: Goal) -> None:
        """See Scheme.check."""
        self._goal, self._goal_prediction = goal, self.predict_goal(goal)

    def compute(self, observation: Observation, goal: Goal, t: float) -> SchemeOutput:
        """See Scheme.compute."""
        if self._goal is not goal:
            self.check(goal)
        found = self.predict(observation)
        # the camera's place before the goal is minus the goal's
        away = self._goal_prediction - found
        away[3] = wrap(away[3])
        L = np.eye(6)[[0, 1, 2, 5]]
        rate = self.law.desired_error_rate(
            away, L, np.array([*away[:3], 0.0, 0.0, away[3]]), t, observation.dt
        )
        twist = np.array([*rate[:3], 0.0, 0.0, rate[3]])
        return SchemeOutput(
            self.names,
            found,
            self._goal_prediction,
            away,
            Task.from_twist(twist, SERVOED_DIRECTIONS),
        )


# The goal of 2015 hangs from a stretched arm: the camera cannot be nearer to the target.
TRAINING_STARTS = Sampler(height=(0.15, 0.5), side=0.1)


def make_training_data(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Inputs (n, 10) and answers (n, 5) of pictures of the demo's target from random places.

    An answer is the goal's place in the camera's frame, m, and cosine and sine of its turn.
    """
    from ..experiment.cameras import is_in_view
    from ..experiment.experiment import Experiment
    from ..plants.imaging import capture
    from ..setup.assembly import assemble
    from ..setup.sampling import draw_pose

    parts = assemble(Experiment(plant="ideal", features="images", goal="2016", start="2016"))
    observer = FeatureObserver(None, frozenset((Need.MOMENTS,)))
    random, sight = np.random.default_rng(seed), parts.plant.imaging
    shape, middle = parts.target.shape, parts.target.shape.vertices().mean(axis=0)
    x, y = [], []
    while len(x) < count:
        pose, _ = draw_pose(TRAINING_STARTS, parts.goal_pose, middle, random)
        try:
            if not is_in_view(
                shape.outline(parts.target.target_T_camera(pose)), parts.calibrated_camera, 2.0
            ):
                continue
        except ViewError:
            continue
        seen = observe(capture(sight, pose, 0, random), None, observer, parts.calibrated_camera)
        if seen.valid:
            c_T_g = relative_pose(pose, parts.goal_pose)
            x.append(make_inputs(seen.moments))
            y.append([*c_T_g[:3, 3], c_T_g[0, 0], c_T_g[1, 0]])
    return np.array(x), np.array(y)


def train(x: np.ndarray, y: np.ndarray, seed: int = 0) -> dict[str, np.ndarray]:
    """Arrays of a Network that answers y (n, 5) to x (n, 10); ExperimentError: no scikit-learn."""
    return fit_network(
        x, y, 0.0, np.float32, hidden_layer_sizes=HIDDEN_LAYERS, activation="tanh", solver="lbfgs",
        max_iter=800, max_fun=1200, alpha=1e-6, random_state=seed, tol=1e-9,
    )  # fmt: skip


def compute_errors(predicted: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far (n,), m, and turned (n,), rad, what is found (n, 4) is from the answers (n, 5)."""
    turn = wrap(predicted[:, 3] - np.arctan2(y[:, 4], y[:, 3]))
    return np.linalg.norm(predicted[:, :3] - y[:, :3], axis=1), np.abs(turn)


def main(argv: list[str] | None = None) -> int:
    """Teach the network; returns the exit status."""
    return run_training(
        GoalPoseNetwork,
        argv,
        __doc__.splitlines()[0],
        4000,
        200,
        make_training_data,
        train,
        compute_errors,
    )


if __name__ == "__main__":
    sys.exit(main())
