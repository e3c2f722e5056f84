"""The diagonal law: one constant gain for each feature."""

from __future__ import annotations

import dataclasses

import numpy as np

from aras_visual_servo_base.settings import parameter

from ..errors import ConfigurationError
from .base import LAWS, MAX_GAIN, Law


@LAWS.register("diagonal")
class Diagonal(Law):
    """de_i/dt = -values_i e_i; the laboratory's Lambda."""

    values: tuple[float, ...] = parameter(
        dataclasses.MISSING, "1/s", above=0.0, most=MAX_GAIN, help="gain of each feature"
    )

    def check(self) -> None:
        """See Law.check."""
        super().check()
        if not self.values:
            raise ConfigurationError(f"law {self.name}: values is empty, it must hold a gain for "
                                     "each feature")  # fmt: skip

    def desired_error_rate(
        self,
        error: np.ndarray,
        L: np.ndarray,
        pseudo_inverse_error: np.ndarray,
        t: float,
        dt: float,
    ) -> np.ndarray:
        """See Law.rate.

        Raises:
            ConfigurationError: as many gains as features are needed.
        """
        if len(error) != len(self.values):
            raise ConfigurationError(
                f"law {self.name}: {len(self.values)} values for {len(error)} features"
            )
        return -np.array(self.values) * error
