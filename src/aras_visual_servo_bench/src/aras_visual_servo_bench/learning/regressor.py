"""What networks that answer numbers to numbers share: their file, their layers, their training."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from aras_visual_servo_controller.errors import ConfigurationError

from ..errors import ExperimentError


class Regressor:
    """Layers, the last one linear, between scaled inputs (k,) and outputs (m,).

    Attributes:
        what, make: who needs the weights, and the command that makes them, for messages.
        activation: of the hidden layers, number by number.
    """

    what: ClassVar[str]
    make: ClassVar[str]
    activation: ClassVar[Callable[[np.ndarray], np.ndarray]]

    def __init__(self, arrays: Mapping[str, np.ndarray]) -> None:
        """`arrays`: mean, scale, out_mean, out_scale, and w0, b0, w1, ... of the layers."""
        wide = {name: np.asarray(array, float) for name, array in arrays.items()}
        self._mean, self._scale = wide["mean"], wide["scale"]
        self._out_mean, self._out_scale = wide["out_mean"], wide["out_scale"]
        count = sum(name.startswith("w") for name in wide)
        self._layers = [(wide[f"w{i}"], wide[f"b{i}"]) for i in range(count)]

    @classmethod
    def load(cls, path: Path) -> Self:
        """From a file.

        Raises:
            ConfigurationError: there is none, or it is no network.
        """
        if not path.is_file():
            raise ConfigurationError(f"{cls.what} has no weights at {path}: {cls.make}")
        try:
            with np.load(path, allow_pickle=False) as file:
                return cls(dict(file))
        except (OSError, ValueError, KeyError) as error:
            raise ConfigurationError(f"{path} holds no network ({error}): {cls.make}") from None

    def answer(self, x: np.ndarray) -> np.ndarray:
        """Outputs (m,) to inputs (k,)."""
        values = (x - self._mean) / self._scale
        for w, b in self._layers[:-1]:
            values = type(self).activation(values @ w + b)
        w, b = self._layers[-1]
        return (values @ w + b) * self._out_scale + self._out_mean


def fitted(
    x: np.ndarray, y: np.ndarray, least_scale: float, kept: type, **options: Any
) -> dict[str, np.ndarray]:
    """Arrays of a Regressor that answers y (n, m) to x (n, k).

    Args:
        least_scale: that an input's deviation counts as at least. kept: type of the weights kept.
        options: of scikit-learn's MLPRegressor.

    Raises:
        ExperimentError: no scikit-learn.
    """
    try:
        from sklearn.neural_network import MLPRegressor
    except ImportError:
        raise ExperimentError(
            "training needs scikit-learn: pip install -r requirements/bench.txt"
        ) from None
    mean, scale = x.mean(axis=0), np.maximum(x.std(axis=0), least_scale)
    out_mean, out_scale = y.mean(axis=0), y.std(axis=0)
    network = MLPRegressor(**options)
    network.fit((x - mean) / scale, (y - out_mean) / out_scale)
    arrays = {"mean": mean, "scale": scale, "out_mean": out_mean, "out_scale": out_scale}
    for i, (w, b) in enumerate(zip(network.coefs_, network.intercepts_, strict=True)):
        arrays[f"w{i}"], arrays[f"b{i}"] = w.astype(kept), b.astype(np.float32)
    return arrays
