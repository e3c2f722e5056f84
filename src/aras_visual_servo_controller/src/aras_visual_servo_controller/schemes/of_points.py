"""What schemes share that decide a twist of their own from the target's numbered points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import MeasurementError
from ..features.base import Measured
from ..features.corners import NumberedPoints
from ..goals.goal import Goal
from ..laws import Law
from ..seeing.observation import Observation
from .base import Scheme


class OfPoints(Scheme):
    """Base: give `compute`; s, s* and L (2n x 6, of n points x, y) come by `measured`."""

    def __init__(self, law: Law | None = None) -> None:
        super().__init__(law)
        self.feature = NumberedPoints()
        self.needs = self.feature.needs
        self._describe()

    def check(self, goal: Goal) -> None:
        """See Scheme.check."""
        self.feature.check(goal)
        self._describe()

    def accuracy(self, observation: Observation, goal: Goal) -> np.ndarray | None:
        """See Scheme.accuracy."""
        return self.feature.accuracy(observation, goal)

    def teach(self, observation: Observation) -> Mapping[str, Mapping[str, Any]]:
        """See Scheme.teach."""
        return {self.feature.name: self.feature.teach(observation)}

    def measured(self, observation: Observation, goal: Goal) -> Measured:
        """The points of an observation; MeasurementError where they cannot be measured."""
        if not observation.valid:
            raise MeasurementError(observation.reason or "the target is not visible")
        return self.feature.measure(observation, goal)

    def _describe(self) -> None:
        self.names, self.units = tuple(self.feature.names), tuple(self.feature.units)
        self.tolerances = tuple(self.feature.tolerances)
