"""Base class of schemes that are built on one feature."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from ..errors import MeasurementError
from ..features.base import Feature, FeatureMeasurement, Stack, scale_tolerances
from ..goals.goal import Goal
from ..laws import Law
from ..observation.observation import SEGMENTED, Need, Observation
from .base import Scheme
from .output_checks import check_accuracy, check_measurement, check_taught_entry


class FeatureSchemeBase(Scheme):
    """Base class of schemes on one feature, or on a Stack of several features.

    A subclass implements `compute`, in which it gets s, s*, e and L from
    `check_measurement(feature.measure(require_visible(observation), goal))`.

    Attributes:
        feature: feature that is servoed; by default an instance of `feature_class`.
    """

    feature_class: ClassVar[type[Feature]]

    def __init__(self, law: Law | None = None, feature: Feature | None = None) -> None:
        super().__init__(law)
        self.feature = self.feature_class() if feature is None else feature
        self.needs, self.cameras = self.feature.needs, tuple(self.feature.cameras)
        self._row_count = 0  # number of rows of L in the last image
        self._describe()

    def reset(self) -> None:
        """Forget all earlier images."""
        super().reset()
        self.feature.reset()
        self._row_count = 0

    def check(self, goal: Goal) -> None:
        """Raise an error for a goal that this scheme cannot servo to."""
        self.feature.check(goal)
        self._describe()
        self.tolerances = scale_tolerances(self.feature.tolerances, goal)

    def get_needs(self, *cameras: str) -> frozenset[Need]:
        """Return the measurements that the scheme needs from one camera's image."""
        return self.feature.get_needs(*cameras)

    @property
    def features(self) -> tuple[Feature, ...]:
        """The features of a Stack, or the single feature."""
        return self.feature.features if isinstance(self.feature, Stack) else (self.feature,)

    def accuracy(self, observation: Observation, goal: Goal) -> np.ndarray | None:
        """Return the accuracy of the features in the latest image; see `Feature.accuracy`."""
        found = self.feature.accuracy(observation, goal)
        return None if found is None else check_accuracy(self.feature, found, self._row_count)

    def teach(self, observation: Observation) -> Mapping[str, Mapping[str, Any]]:
        """Return the data that the goal file stores for each feature, from the view at the goal."""
        taught = {f.name: check_taught_entry(f, f.teach(observation)) for f in self.features}
        # Features that store data in the goal, and whose `check` requires an entry in the goal.
        # Even an empty entry is stored for them.
        required = {f.name for f in self.features if type(f).check is Feature.check
                      and type(f).teach is not Feature.teach}  # fmt: skip
        return {name: entry for name, entry in taught.items() if entry or name in required}

    def require_visible(self, observation: Observation) -> Observation:
        """Return the observation unchanged if all targets that the feature needs are visible.

        Raises:
            MeasurementError: a target is not visible.
        """
        if not observation.other_cameras:
            if self.needs & SEGMENTED and not observation.valid:
                raise MeasurementError(observation.reason or "the target is not visible")
            return observation
        for name, view in observation.cameras.items():
            own = (name,) if view.twist_from_control is not None else ("", name)
            if self.get_needs(*own) & SEGMENTED and not view.valid:
                reason = view.reason or "the target is not visible"
                raise MeasurementError(f"camera {name}: {reason}")
        return observation

    def check_measurement(self, measurement: object) -> FeatureMeasurement:
        """Return the result of `feature.measure` with float64 arrays.

        Raises:
            SchemeError: a shape is wrong, or a value is not finite.
        """
        measured = check_measurement(self.feature, measurement)
        self._row_count = len(measured.error)
        return measured

    def _describe(self) -> None:
        """Copy names, tolerances and units from the feature; they can depend on the goal."""
        self.names, self.units = tuple(self.feature.names), tuple(self.feature.units)
        self.tolerances = tuple(self.feature.tolerances)
