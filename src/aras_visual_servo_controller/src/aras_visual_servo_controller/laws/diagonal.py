"""The diagonal law: one constant gain for each feature."""

from __future__ import annotations

import dataclasses

import numpy as np

from aras_visual_servo_base.settings import parameter

from ..errors import ConfigurationError
from .base import LAWS, MAX_GAIN, Law


@LAWS.register("diagonal")
class Diagonal(Law):
    """Diagonal gain matrix: de_i/dt = -values_i e_i, where values_i is the gain of feature i."""

    values: tuple[float, ...] = parameter(
        dataclasses.MISSING, "1/s", above=0.0, most=MAX_GAIN, help="gain of each feature"
    )

    def check(self) -> None:
        """Raise an error for parameters that are out of bounds or do not fit together."""
        super().check()
        if not self.values:
            raise ConfigurationError(
                f"law {self.name}: values is empty; give a gain for each feature"
            )

    def desired_error_rate(
        self,
        error: np.ndarray,
        L: np.ndarray,
        pseudo_inverse_error: np.ndarray,
        t: float,
        dt: float,
    ) -> np.ndarray:
        """Compute the desired rate of the error, e_dot (k,).

        Raises:
            ConfigurationError: the number of gains differs from the number of features.
        """
        if len(error) != len(self.values):
            raise ConfigurationError(
                f"law {self.name}: values has {len(self.values)} gains, must have one for each of "
                f"the {len(error)} features"
            )
        return -np.array(self.values) * error
