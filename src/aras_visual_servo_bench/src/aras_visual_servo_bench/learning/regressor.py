"""What networks that answer numbers to numbers share: their file, their layers, their training."""

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
    """Layers, the last one linear, between scaled inputs (k,) and outputs (m,).

    Attributes:
        what: who needs the weights, for messages. module: that makes them, of this package.
        activation: of the hidden layers, number by number.
    """

    user: ClassVar[str]
    module: ClassVar[str]
    activation: ClassVar[Callable[[np.ndarray], np.ndarray]]

    def __init__(self, arrays: Mapping[str, np.ndarray]) -> None:
        """`arrays`: mean, scale, out_mean, out_scale, and w0, b0, w1, ... of the layers."""
        wide = {name: np.asarray(array, float) for name, array in arrays.items()}
        self._mean, self._scale = wide["mean"], wide["scale"]
        self._out_mean, self._out_scale = wide["out_mean"], wide["out_scale"]
        count = sum(name.startswith("w") for name in wide)
        self._layers = [(wide[f"w{i}"], wide[f"b{i}"]) for i in range(count)]

    @classmethod
    def find_weights(cls) -> Path:
        """The shipped file of the weights."""
        return Path(PackagePath().find("aras_visual_servo_bench")) / "config" / f"{cls.module}.npz"

    @classmethod
    def load(cls, path: Path | None = None) -> Self:
        """From a file; None: the one that the environment names, or else the shipped one.

        Raises:
            ConfigurationError: there is none, or it is no network.
        """
        if path is None:
            variable = f"ARAS_{cls.module.upper()}_WEIGHTS"
            path = Path(os.environ.get(variable, cls.find_weights()))
        make = f"make it: python3 -m aras_visual_servo_bench.learning.{cls.module}"
        if not path.is_file():
            raise ConfigurationError(f"{cls.user} has no weights at {path}: {make}")
        try:
            with np.load(path, allow_pickle=False) as file:
                return cls(dict(file))
        except (OSError, ValueError, KeyError) as error:
            raise ConfigurationError(f"{path} holds no network ({error}): {make}") from None

    def predict(self, x: np.ndarray) -> np.ndarray:
        """Outputs (m,) to inputs (k,)."""
        values = (x - self._mean) / self._scale
        for w, b in self._layers[:-1]:
            values = type(self).activation(values @ w + b)
        w, b = self._layers[-1]
        return (values @ w + b) * self._out_scale + self._out_mean


def run_training(
    kind: type[Regressor], argv: list[str] | None, description: str, count: int, test_count: int,
    make_data: Callable[..., tuple[np.ndarray, np.ndarray]],
    train: Callable[[np.ndarray, np.ndarray], dict[str, np.ndarray]],
    compute_errors: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]],
) -> int:  # fmt: skip
    """A command that makes pictures, learns, writes the weights, and says how well it knows unseen
    pictures; returns the exit status.

    Args:
        text: what it does. count: of pictures, unless told. unseen: pictures to judge it by.
        pictures: inputs and answers of so many pictures, by a seed.
        train: arrays of the network. off: distances (n,), m, and angles (n,), rad, by which what is
            found (n, m) misses the answers.
    """
    parser = argparse.ArgumentParser(
        description=description,
        epilog=f"example: python3 -m {__package__}.{kind.module} --pictures 1000 --out mine.npz",
    )  # fmt: skip
    parser.add_argument("--pictures", type=int, default=count)
    parser.add_argument("--out", type=Path, default=kind.find_weights())
    options = parser.parse_args(argv)
    try:
        arrays = train(*make_data(options.pictures))
    except ExperimentError as error:
        print(f"{kind.module}: {error}", file=sys.stderr)
        return 1
    options.out.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(options.out, **arrays)
    x, y = make_data(test_count, seed=1)
    network = kind.load(options.out)
    far, turn = (np.median(n) for n in compute_errors(np.array([network(row) for row in x]), y))
    print(f"wrote {options.out}; of {test_count} unseen pictures half are within {1e3 * far:.1f} "
          "mm "
          f"and {np.degrees(turn):.2f} degrees")  # fmt: skip
    return 0


def fit_network(
    x: np.ndarray, y: np.ndarray, min_scale: float, dtype: type,
    refinements: Sequence[tuple[float, int]] = (), **options: Any,
) -> dict[str, np.ndarray]:
    """Arrays of a Regressor that answers y (n, m) to x (n, k).

    Args:
        least_scale: that an input's deviation counts as at least. kept: type of the weights kept.
        refined: learning rates and epochs that follow: steps of one size leave the weights astray.
        options: of scikit-learn's MLPRegressor.

    Raises:
        ExperimentError: no scikit-learn.
    """
    try:
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.neural_network import MLPRegressor
    except ImportError:
        raise ExperimentError(
            "training needs scikit-learn: pip install -r requirements/bench.txt"
        ) from None
    mean, scale = x.mean(axis=0), np.maximum(x.std(axis=0), min_scale)
    out_mean, out_scale = y.mean(axis=0), y.std(axis=0)
    network = MLPRegressor(**options)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # its iterations are what was asked for
        network.fit(x := (x - mean) / scale, y := (y - out_mean) / out_scale)
        for rate, epochs in refinements:
            network.set_params(learning_rate_init=rate, max_iter=epochs, warm_start=True)
            network.fit(x, y)
    arrays = {"mean": mean, "scale": scale, "out_mean": out_mean, "out_scale": out_scale}
    for i, (w, b) in enumerate(zip(network.coefs_, network.intercepts_, strict=True)):
        arrays[f"w{i}"], arrays[f"b{i}"] = w.astype(dtype), b.astype(np.float32)
    return arrays
