"""Feature whose value is the camera's pose predicted by a network, and its training command.

    python3 -m aras_visual_servo_bench.learning.learned_pose [--pictures 24000] [--out FILE]

The image is reduced in size, and its brightness and contrast are normalised. A small network
predicts the camera's pose from it. The feature is the pose predicted for the current image,
relative to the pose predicted for the image at the goal, so there is no bias at the goal. The
network is trained on simulated images of the poster of the study convergence_domain, with and
without changes of the poster.

References: Q. Bateux and others, Training deep neural networks for visual servoing, IEEE ICRA 2018;
S. Felton and others, Siame-se(3), IEEE ICRA 2021. The training uses the start poses of the second
paper. This network is a thousand times smaller than the networks of the papers, and is trained in
minutes without a graphics card.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from aras_visual_servo_base.poses import (
    exponential,
    inverse,
    logarithm,
    matrix_from_xyz_rpy,
    relative_pose,
    rotation_vector,
    rotation_vector_rate,
)
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.features.base import Feature, FeatureMeasurement
from aras_visual_servo_controller.features.luminance import get_grey_image
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.observation.observation import Need, Observation

from .regressor import Regressor, run_training

COLUMNS, ROWS = 28, 21  # size of the network's input image, px
PROTOCOL = "convergence_domain"
TEXTURE_COUNT = 120  # number of changed versions of the poster in the training images
PLACES_BETWEEN = 3  # number of training poses near the path from each start to the goal
# Training poses deviate at random from the straight path to the goal. These are the standard
# deviations at the start of the path, m and degrees; they decrease linearly to 0 at the goal.
PATH_DEVIATION = (0.02, 2.0)


def make_inputs(grey: np.ndarray) -> np.ndarray:
    """Compute the inputs (ROWS * COLUMNS,) of the network from a grey image with `shrink_image`."""
    return shrink_image(grey, COLUMNS, ROWS)


def shrink_image(grey: np.ndarray, columns: int, rows: int) -> np.ndarray:
    """Reduce the size of a grey image (uint8) and normalise its brightness and contrast.

    Returns:
        (rows * columns,) values with the mean 0 and the standard deviation 1.
    """
    small = cv2.resize(grey, (columns, rows), interpolation=cv2.INTER_AREA).astype(float).ravel()
    return (small - small.mean()) / max(float(small.std()), 1.0)


def relu(values: np.ndarray) -> np.ndarray:
    """Return max(x, 0) for each value x."""
    return np.maximum(values, 0.0)


class PoseNetwork(Regressor):
    """Network with ReLU layers that predicts the camera's pose."""

    user, module = "the learned feature", "learned_pose"
    activation = staticmethod(relu)
    training = {
        "min_scale": 1e-6, "dtype": np.float16, "hidden_layer_sizes": (160, 96),
        "activation": "relu", "solver": "adam", "alpha": 1e-4, "batch_size": 100,
        "learning_rate_init": 1e-3, "max_iter": 60, "n_iter_no_change": 60, "tol": 0.0,
    }  # fmt: skip

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Predict the logarithm (6,), m and rad, of the camera's pose from inputs (k,).

        The pose is relative to the goal of the training data.
        """
        return self.predict(x)


class LearnedPose(Feature):
    """Pose of the camera in the goal's frame, which a network predicts from the image.

    The feature is s = (g_t_c, theta u): the position of the camera in the goal's frame, m, and the
    rotation vector, rad. Its interaction matrix is L = diag(g_R_c, J), where J maps the angular
    velocity of the camera to the time derivative of theta u.
    """

    name, is_geometric = "learned_pose", False
    needs = frozenset((Need.IMAGE,))
    names = ("tx", "ty", "tz", "ux", "uy", "uz")
    tolerances, units = (0.002,) * 3 + (0.005,) * 3, ("m",) * 3 + ("rad",) * 3

    def __init__(self) -> None:
        self._network = PoseNetwork.load()
        self._goal: Goal | None = None

    def teach(self, observation: Observation) -> Mapping[str, Any]:
        """Return the network's prediction for the image at the goal, as `Feature.teach` requires.
        """
        return {"pose": self._network(make_inputs(get_grey_image(observation))).tolist()}

    def check(self, goal: Goal) -> None:
        """Check a goal and read the prediction stored in it, as `Feature.check` requires."""
        prediction = np.array(dict(goal.features.get(self.name, {})).get("pose", ()), float)
        if prediction.shape != (6,) or not np.isfinite(prediction).all():
            raise ConfigurationError(
                f"the goal {goal.name} contains no {self.name}: teach it again with this feature"
            )
        self._goal, self._goal_T_reference = goal, inverse(exponential(prediction))

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """Compute the feature s and its interaction matrix L, as `Feature.measure` requires."""
        if self._goal is not goal:
            self.check(goal)
        reference_T_c = exponential(self._network(make_inputs(get_grey_image(observation))))
        g_T_c = self._goal_T_reference @ reference_T_c
        turn = rotation_vector(g_T_c[:3, :3])
        s, L = np.concatenate([g_T_c[:3, 3], turn]), np.zeros((6, 6))
        L[:3, :3], L[3:, 3:] = g_T_c[:3, :3], rotation_vector_rate(turn)
        return FeatureMeasurement(s, np.zeros(6), s, L)


def make_training_data(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Make training data from images of the poster of the study convergence_domain.

    The poses of the camera are random starts with the distribution of this study, and poses near
    the straight paths from these starts to the goal. In every other image, the poster is changed.

    Args:
        count: number n of images.
        seed: seed of the poses and of the changes of the poster.

    Returns:
        Inputs (n, ROWS * COLUMNS), and outputs (n, 6): the logarithm of the camera's pose relative
        to the goal, m and rad.
    """
    from ..cli.run import find_study_file
    from ..experiment.experiment import Experiment
    from ..setup.assembly import assemble
    from ..studies.study import Study
    from ..targets.rendering import render_target

    study = Study.from_yaml(find_study_file(Path(PROTOCOL)))
    starts = study.combinations[0].set["start"]
    base = Experiment.from_mapping({**study.experiment, "scheme": "luminance", "start": starts})
    parts = assemble(base)
    poster, goal = parts.target.shape, parts.goal_pose
    camera = _reduce_camera(parts.calibrated_camera)
    random = np.random.default_rng((seed, 4711))
    make_texture = functools.cache(lambda i: poster.perturb(100_000 * (seed + 1) + i))
    x, y = [], []
    for number in range(-(-count // (1 + PLACES_BETWEEN))):
        # The study does not use these seeds, so its own starts do not occur in the training.
        pose = base.with_changes(
            seed=1_000_000 * (seed + 1) + number
        ).with_absolute_start.start.pose
        displacement = logarithm(relative_pose(goal, matrix_from_xyz_rpy(pose[:3], pose[3:])))
        for step in range(1 + PLACES_BETWEEN):
            part = 1.0 if step == 0 else random.uniform(0.0, 1.0)
            deviation = (
                random.normal(size=6)
                * part
                * np.repeat((PATH_DEVIATION[0], np.radians(PATH_DEVIATION[1])), 3)
            )
            motion = part * displacement + (deviation if step else 0.0)
            shape = poster if step % 2 == 0 else make_texture(random.integers(TEXTURE_COUNT))
            grey = render_target(
                shape, camera, parts.target.target_T_camera(goal @ exponential(motion))
            )
            x.append(make_inputs(grey))
            y.append(motion)
    return np.array(x[:count]), np.array(y[:count])


def _reduce_camera(camera: CameraModel) -> CameraModel:
    """Return a camera with the same field of view and a quarter of the columns and of the rows."""
    fx, _, cx, _, fy, cy, *_ = camera.K
    K = (fx / 4, 0.0, (cx + 0.5) / 4 - 0.5, 0.0, fy / 4, (cy + 0.5) / 4 - 0.5, 0.0, 0.0, 1.0)
    return CameraModel(camera.width // 4, camera.height // 4, K)


def compute_errors(predicted: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the errors of predictions.

    Args:
        predicted: (n, 6) predictions of the network.
        y: (n, 6) true outputs, as in `make_training_data`.

    Returns:
        Norms of the translational differences (n,), m, and of the rotational differences (n,), rad.
    """
    return tuple(
        np.linalg.norm((predicted - y)[:, part], axis=1) for part in (np.s_[:3], np.s_[3:])
    )


def main(argv: list[str] | None = None) -> int:
    """Run the training command and return its exit status."""
    return run_training(
        PoseNetwork, argv, __doc__.splitlines()[0], 24_000, 400, make_training_data, compute_errors
    )


if __name__ == "__main__":
    sys.exit(main())
