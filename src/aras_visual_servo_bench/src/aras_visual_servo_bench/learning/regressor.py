"""Base class of small neural networks: training, prediction, and the file of weights."""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from aras_visual_servo_controller.errors import ConfigurationError

from ..errors import ExperimentError
from ..experiment.packages import PackagePath


class Regressor:
    """Feedforward network that computes outputs (m,) from inputs (k,).

    Inputs and outputs are scaled, and the last layer is linear.

    Attributes:
        user: name of the scheme or feature that uses the network, for messages.
        module: module of this package with the training command of the network.
        activation: activation function of the hidden layers.
        training: options of `fit_network`.
    """

    user: ClassVar[str]
    module: ClassVar[str]
    activation: ClassVar[Callable[[np.ndarray], np.ndarray]]
    training: ClassVar[Mapping[str, Any]]

    def __init__(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Create a network from its arrays.

        Args:
            arrays: `mean` and `scale` of the inputs, `out_mean` and `out_scale` of the outputs, and
                the weights w0, w1, ... and biases b0, b1, ... of the layers.
        """
        values = {name: np.asarray(array, float) for name, array in arrays.items()}
        self._mean, self._scale = values["mean"], values["scale"]
        self._out_mean, self._out_scale = values["out_mean"], values["out_scale"]
        count = sum(name.startswith("w") for name in values)
        self._layers = [(values[f"w{i}"], values[f"b{i}"]) for i in range(count)]

    @classmethod
    def find_weights(cls) -> Path:
        """Return the path of the file with the weights that this package contains."""
        return Path(PackagePath().find("aras_visual_servo_bench")) / "config" / f"{cls.module}.npz"

    @classmethod
    def load(cls, path: Path | None = None) -> Self:
        """Load a network from a file.

        By default, it is the file whose path is in the environment variable ARAS_<MODULE>_WEIGHTS.
        If this variable is not set, it is the file that this package contains.

        Raises:
            ConfigurationError: the file does not exist, or does not contain a network.
        """
        if path is None:
            variable = f"ARAS_{cls.module.upper()}_WEIGHTS"
            path = Path(os.environ.get(variable, cls.find_weights()))
        make = f"to train it, run: python3 -m aras_visual_servo_bench.learning.{cls.module}"
        if not path.is_file():
            raise ConfigurationError(
                f"the network of {cls.user} is missing: there is no file {path}; {make}"
            )
        try:
            with np.load(path, allow_pickle=False) as file:
                return cls(dict(file))
        except (OSError, ValueError, KeyError) as error:
            raise ConfigurationError(
                f"{path} does not contain a network ({error}); {make}"
            ) from None

    @classmethod
    def train(cls, x: np.ndarray, y: np.ndarray, seed: int = 0) -> dict[str, np.ndarray]:
        """Train a network and return its arrays.

        Args:
            x: (n, k) inputs.
            y: (n, m) outputs.
            seed: seed of the initial weights.

        Raises:
            ExperimentError: scikit-learn is not installed.
        """
        return fit_network(x, y, random_state=seed, **cls.training)

    def predict(self, x: np.ndarray) -> np.ndarray:
        """Compute the outputs (m,) from inputs (k,)."""
        values = (x - self._mean) / self._scale
        for w, b in self._layers[:-1]:
            values = type(self).activation(values @ w + b)
        w, b = self._layers[-1]
        return (values @ w + b) * self._out_scale + self._out_mean


def run_training(
    kind: type[Regressor], argv: list[str] | None, description: str, count: int, test_count: int,
    make_data: Callable[..., tuple[np.ndarray, np.ndarray]],
    compute_errors: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]],
) -> int:  # fmt: skip
    """Run a training command.

    It makes images, trains a network, writes the weights, and prints the errors for test images.

    Args:
        kind: class of the network.
        argv: arguments of the command; None for the arguments of the process.
        description: help text of the command.
        count: default number of training images.
        test_count: number of test images.
        make_data: function that returns inputs and outputs. Its arguments are the number of images
            and a seed.
        compute_errors: function that returns the position errors (n,), m, and the rotation errors
            (n,), rad. Its arguments are n predictions and the true outputs.

    Returns:
        The exit status.
    """
    parser = argparse.ArgumentParser(
        description=description,
        epilog=f"example: python3 -m {__package__}.{kind.module} --pictures 1000 --out mine.npz",
    )  # fmt: skip
    parser.add_argument(
        "--pictures", type=int, default=count, help="number of training images"
    )
    parser.add_argument(
        "--out", type=Path, default=kind.find_weights(), help="file for the weights"
    )
    options = parser.parse_args(argv)
    try:
        arrays = kind.train(*make_data(options.pictures))
    except ExperimentError as error:
        print(f"{kind.module}: {error}", file=sys.stderr)
        return 1
    options.out.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(options.out, **arrays)
    x, y = make_data(test_count, seed=1)
    network = kind.load(options.out)
    distance, angle = (
        np.median(n) for n in compute_errors(np.array([network(row) for row in x]), y)
    )
    print(f"wrote {options.out}; median error on {test_count} test images: "
          f"{1e3 * distance:.1f} mm, {np.degrees(angle):.2f} degrees")  # fmt: skip
    return 0


def fit_network(
    x: np.ndarray, y: np.ndarray, min_scale: float, dtype: type,
    refinements: Sequence[tuple[float, int]] = (), **options: Any,
) -> dict[str, np.ndarray]:
    """Train a Regressor and return its arrays.

    Args:
        x: (n, k) inputs.
        y: (n, m) outputs.
        min_scale: smallest scale of an input; inputs are divided by their scale.
        dtype: data type of the stored weights.
        refinements: learning rate and number of epochs of each phase after the first training.
        options: options of scikit-learn's MLPRegressor.

    Raises:
        ExperimentError: scikit-learn is not installed.
    """
    try:
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.neural_network import MLPRegressor
    except ImportError:
        raise ExperimentError(
            "training needs scikit-learn, which is not installed; run: pip install -r "
            "requirements/bench.txt"
        ) from None
    mean, scale = x.mean(axis=0), np.maximum(x.std(axis=0), min_scale)
    out_mean, out_scale = y.mean(axis=0), y.std(axis=0)
    network = MLPRegressor(**options)
    with warnings.catch_warnings():
        # The number of iterations is limited on purpose, so the warning about it is suppressed.
        warnings.simplefilter("ignore", ConvergenceWarning)
        network.fit(x := (x - mean) / scale, y := (y - out_mean) / out_scale)
        for rate, epochs in refinements:
            network.set_params(learning_rate_init=rate, max_iter=epochs, warm_start=True)
            network.fit(x, y)
    arrays = {"mean": mean, "scale": scale, "out_mean": out_mean, "out_scale": out_scale}
    for i, (w, b) in enumerate(zip(network.coefs_, network.intercepts_, strict=True)):
        arrays[f"w{i}"], arrays[f"b{i}"] = w.astype(dtype), b.astype(np.float32)
    return arrays
