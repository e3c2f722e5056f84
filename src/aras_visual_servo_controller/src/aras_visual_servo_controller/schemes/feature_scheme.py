"""Schemes that are built on one or more features, and the general one of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from aras_visual_servo_base.names import describe_unknown

from ..errors import ConfigurationError, MeasurementError
from ..features.base import Feature, FeatureMeasurement, Stack, scale_tolerances
from ..goals.goal import Goal
from ..kinematics.algebra import ROUNDING_TOLERANCE, is_well_conditioned, solve_scaled
from ..kinematics.task import Task
from ..laws import Law
from ..observation.observation import SEGMENTED, Need, Observation
from .base import Scheme, SchemeOutput
from .scheme_call import (
    check_accuracy,
    check_array,
    check_measurement,
    check_taught_entry,
)

INTERACTIONS = ("current", "desired", "mean", "estimated")
LONGEST_GAP = 0.3  # time between two images, s; a longer gap restarts the filter of the error
# The low-pass filter of the error restarts if a component of the error in rad or normalised
# coordinates changes by more than this between two images. Such a component may be an angle that
# has jumped by a turn.
LONGEST_JUMP = 1.0
# If features are measured in images with unknown accuracy, singular values of L below this fraction
# of the largest one are treated as noise.
NOISE_RANK_TOLERANCE = 1e-4
# L is treated as well conditioned if its smallest singular value is above this fraction of the
# largest one. Then noise matters little, and all camera directions are controlled.
WELL_CONDITIONED = 0.05
Estimator = Callable[[Observation, FeatureMeasurement], np.ndarray]


@lru_cache
def _make_twist_scale(distance: float) -> np.ndarray:
    """Return factors (6,) that convert a twist with `distance` as unit of length to m and rad."""
    return np.array((distance,) * 3 + (1.0,) * 3)


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


class FeatureScheme(FeatureSchemeBase):
    """Scheme e_dot = law(e) on one or more features.

    The interaction matrix L is computed at the current view or at the goal, or it is the mean of
    these two matrices, or an estimate.

    Attributes:
        feature: the feature, or a Stack that combines several features.
        law: control law.
        interaction: one of INTERACTIONS.
        smoothing: time constant of a low-pass filter on the error, s; 0 for none. The law uses the
            filtered error, SchemeOutput.filtered_error; SchemeOutput.error is not filtered.
        ratio: (k,) factors by which the desired error rates are multiplied; None for no factors.
        estimator: callable that returns L (k, 6) for an observation and its measurement, with an
            optional method `reset`, for interaction 'estimated'. The default is Broyden's rule.
    """

    def __init__(
        self,
        features: Feature | Sequence[Feature],
        law: Law | None = None,
        interaction: str = "current",
        smoothing: float = 0.0,
        weights: Sequence[float] | None = None,
        ratio: Sequence[float] | None = None,
        estimator: Estimator | None = None,
    ) -> None:
        parts = [features] if isinstance(features, Feature) else list(features)
        alone = len(parts) == 1 and weights is None
        super().__init__(law, parts[0] if alone else Stack(parts, weights))
        if interaction not in INTERACTIONS:
            raise ConfigurationError(describe_unknown("interaction", interaction, INTERACTIONS))
        if estimator is not None and interaction != "estimated":
            raise ConfigurationError(
                f"an estimator can be used only with interaction 'estimated', not '{interaction}'"
            )
        if interaction == "estimated" and estimator is None:
            from .broyden_estimator import BroydenEstimator

            estimator = BroydenEstimator()
        if not (np.isfinite(smoothing) and smoothing >= 0.0):
            raise ConfigurationError(f"smoothing is {smoothing}, must be >= 0 s")
        if ratio is not None and (
            len(ratio) != len(self.feature.names) or not (np.asarray(ratio) > 0.0).all()
        ):
            raise ConfigurationError(
                f"ratio is {ratio}, must be one number above 0 for each of "
                f"{', '.join(self.feature.names)}"
            )
        self.interaction, self.smoothing, self.estimator = interaction, float(smoothing), estimator
        self.ratio = None if ratio is None else np.array(ratio, float)
        # A wrong camera model can be detected only by comparing the change of the error with the L
        # of the present view.
        self.can_check_camera = interaction == "current" and self.feature.is_geometric
        self._filter_state: tuple[float, np.ndarray] | None = None

    def reset(self) -> None:
        """Forget all earlier images."""
        super().reset()
        if self.estimator is not None and hasattr(self.estimator, "reset"):
            self.estimator.reset()
        self._filter_state = None

    def _describe(self) -> None:
        super()._describe()
        self._modelled = np.array(self.feature.directions, bool)

    def check(self, goal: Goal) -> None:
        """Raise an error for a goal that this scheme cannot servo to."""
        super().check(goal)
        if self.interaction in ("desired", "mean"):
            self.feature.desired_interaction(goal)

    def compute(self, observation: Observation, goal: Goal, t: float) -> SchemeOutput:
        """Compute the features of an image and the camera task."""
        if observation.other_cameras or not observation.valid:
            self.require_visible(observation)
        measured = self.check_measurement(self.feature.measure(observation, goal))
        L = measured.L
        if self.interaction != "current":
            L = self._choose_interaction(observation, measured, goal)
        modelled = L * self._modelled
        filtered = measured.error
        if self.smoothing > 0.0:
            filtered = self._filter_error(filtered, observation.stamp)
        scale = _make_twist_scale(goal.distance)
        A, b, weights = modelled * scale, filtered, self.feature.weights
        if weights is not None:
            A, b = weights[:, None] * A, weights * b
        if len(A) > 64:  # the normal equations are faster if L has many rows
            A, b = A.T @ A, A.T @ b
        camera_error = np.empty(6)
        solve_scaled(A, b, ROUNDING_TOLERANCE, scale, camera_error)
        desired_rate = self.law.desired_error_rate(
            filtered, modelled, camera_error, t, observation.dt
        )
        desired_rate = check_array(self.law, "desired_error_rate", desired_rate, filtered.shape)
        if self.interaction == "mean":
            # For a rotation by theta, the mean of the two L gives a rate proportional to 2
            # tan(theta / 2) instead of theta. If the computed angle exceeds pi, the rate is reduced
            # to that for an angle of pi.
            angle = float(np.linalg.norm(camera_error[3:]))
            desired_rate = desired_rate * (np.pi / max(angle, np.pi))
        if self.ratio is not None:
            desired_rate = self.ratio * desired_rate
        summary, rate = measured.error_summary, desired_rate - measured.error_drift
        known = self._estimate_accuracy(L, observation, goal)
        return SchemeOutput(
            names=self.names,
            features=measured.s if summary is None else summary,
            desired=measured.desired if summary is None else np.zeros_like(summary),
            error=measured.error if summary is None else summary,
            task=(
                Task(L, rate, self._modelled, goal.distance, **known)
                if weights is None
                else Task.from_interaction(L, rate, self._modelled, weights, goal.distance, **known)
            ),
            L=L,
            residual=None if summary is None else measured.error,
            error_drift=measured.error_drift if summary is None else 0.0,
            filtered_error=filtered if self.smoothing > 0.0 and summary is None else None,
            ambiguity=measured.ambiguity,
            notes=measured.notes,
        )

    def _estimate_accuracy(
        self, L: np.ndarray, observation: Observation, goal: Goal
    ) -> dict[str, Any]:
        """Return keyword arguments with which `Task` finds directions that are too uncertain.

        There are none if L (k, 6) is well conditioned, because then no direction is too uncertain.
        Otherwise the argument is `accuracy`, the accuracy of the features in this image, or
        `rank_tolerance` if this accuracy is unknown.
        """
        if is_well_conditioned(L, self._modelled, goal.distance, WELL_CONDITIONED):
            return {}
        if observation.corner_noise:
            observation = observation.with_noise()
        accuracy = self.accuracy(observation, goal)
        if accuracy is not None:
            return {"accuracy": accuracy}
        return {"rank_tolerance": NOISE_RANK_TOLERANCE} if observation.is_from_image else {}

    def _choose_interaction(
        self, observation: Observation, measured: FeatureMeasurement, goal: Goal
    ) -> np.ndarray:
        if self.interaction == "estimated":
            L = self.estimator(observation, measured)
            return check_array(self.estimator, "__call__", L, measured.L.shape)
        desired = self.feature.desired_interaction(goal)
        desired = check_array(self.feature, "desired_interaction", desired, measured.L.shape)
        return desired if self.interaction == "desired" else 0.5 * (measured.L + desired)

    def _filter_error(self, error: np.ndarray, stamp: float) -> np.ndarray:
        """Return the error (k,) after a first-order low-pass filter.

        A gap between two images or a jump of the error restarts the filter. The filter is needed
        because image edges have a finite number of grey levels: the angle of a nearly square target
        jumps by some mrad between images, which makes a joint with friction tremble.
        """
        if self._filter_state is not None:
            before, value = self._filter_state
            dt = stamp - before
            same = np.shape(value) == np.shape(error)
            wraps = [unit != "m" for unit in self.units] or slice(None)
            jump = np.abs(error - value)[wraps].max(initial=0.0) if same else np.inf
            if 0.0 <= dt <= LONGEST_GAP and jump < LONGEST_JUMP:
                error = value + (1.0 - np.exp(-dt / self.smoothing)) * (error - value)
        self._filter_state = (stamp, error)
        return error
