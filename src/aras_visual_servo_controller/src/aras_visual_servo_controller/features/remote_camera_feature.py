"""A feature that is measured by another camera than the control camera, such as `points@right`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from aras_visual_servo_base.poses import adjoint, relative_pose

from ..errors import ConfigurationError
from ..goals.goal import Goal
from ..observation.observation import Need, Observation
from .base import Feature, FeatureMeasurement, scale_tolerances

ROUNDING = 1e-6  # elements of an adjoint matrix below this are treated as 0


class RemoteCameraFeature(Feature):
    """A feature measured by another camera than the control camera.

    Its L is transformed to the twist of the control camera. If the other camera exposed earlier, s
    is extrapolated to the control camera's exposure. A direction of the control camera counts as
    controlled if a motion in it moves the other camera in a controlled direction of the wrapped
    feature.
    """

    def __init__(self, feature: Feature, camera: str) -> None:
        """Wrap `feature`, measured by the camera named `camera`."""
        self.feature, self.camera = feature, camera
        self.cameras, self.needs = (camera,), feature.needs
        self.is_geometric, self.is_stackable = feature.is_geometric, feature.is_stackable
        self.name = f"{feature.name or type(feature).__name__}@{camera}"
        self._cached_goals: tuple[Goal, Goal] | None = None
        self.tolerances = feature.tolerances
        self._describe(None)

    def _describe(self, control_T_camera: np.ndarray | None) -> None:
        """Copy the attributes of the wrapped feature, which can depend on the goal.

        Args:
            control_T_camera: (4, 4) pose of the camera at the goal; None if it is the control
                camera.
        """
        feature = self.feature
        self.names = tuple(f"{self.camera}.{name}" for name in feature.names)
        self.units = feature.units
        self.weights = feature.weights
        modelled = np.array(feature.directions, bool)
        if control_T_camera is not None:
            mapped = np.abs(adjoint(control_T_camera)[:, modelled])
            modelled = (mapped > ROUNDING).any(axis=1)
        self.directions = tuple(modelled.tolist())

    def measure(self, observation: Observation, goal: Goal) -> FeatureMeasurement:
        """Measure s, s*, the error and L in one image."""
        view = observation.cameras[self.camera]
        found = self.feature.measure(view, self._make_camera_goal(goal))
        if view.twist_from_control is None:
            return found
        since = view.compute_change_since_exposure(found.L)
        if view.motion_since_exposure is not None:
            since = since + np.asarray(found.error_drift) * (observation.stamp - view.stamp)
        return replace(
            found,
            s=found.s + since,
            error=found.error + since,
            L=view.transform_to_control(found.L),
        )

    def desired_interaction(self, goal: Goal) -> np.ndarray:
        """Return the interaction matrix L (k, 6) at the goal."""
        L = self.feature.desired_interaction(self._make_camera_goal(goal))
        if self.camera == goal.camera_name:
            return L
        return L @ adjoint(_compute_control_pose(goal, self.camera))

    def accuracy(self, observation: Observation, goal: Goal) -> np.ndarray | None:
        """Return the accuracy of s in the latest image."""
        return self.feature.accuracy(observation.cameras[self.camera], self._make_camera_goal(goal))

    def check(self, goal: Goal) -> None:
        """Refuse a goal that this feature cannot servo to."""
        if self.camera not in goal.cameras:
            raise ConfigurationError(
                f"{goal.name} has no view of camera '{self.camera}': teach it with this scheme"
            )
        self.feature.check(self._make_camera_goal(goal))
        self.tolerances = scale_tolerances(self.feature.tolerances, self._make_camera_goal(goal))
        control = self.camera == goal.camera_name
        self._describe(None if control else relative_pose(*(
            goal.cameras[name].world_T_camera for name in (goal.camera_name, self.camera)
        )))  # fmt: skip

    def teach(self, observation: Observation) -> Mapping[str, Any]:
        """Return the data that the goal file stores for this feature, from the view at the goal."""
        return self.feature.teach(observation.cameras[self.camera])

    def reset(self) -> None:
        """Forget earlier images."""
        self.feature.reset()

    def get_needs(self, *cameras: str) -> frozenset[Need]:
        """Return the measurements that the feature needs from one camera's image."""
        return self.feature.get_needs(*cameras)

    def _make_camera_goal(self, goal: Goal) -> Goal:
        """Return the goal of this camera for the wrapped feature."""
        if self._cached_goals is None or self._cached_goals[0] is not goal:
            taught = goal.features.get(self.name)
            own = goal.cameras[self.camera]
            if taught is not None:
                name = self.feature.name or type(self.feature).__name__
                own = replace(own, features={**own.features, name: taught})
            self._cached_goals = goal, own
        return self._cached_goals[1]


def check_controllability(features: Iterable[Feature], fixed_cameras: str) -> None:
    """Raise an error if a feature is measured by a fixed camera whose target the arm does not move.

    Args:
        features: features of the scheme.
        fixed_cameras: name of this camera.

    Raises:
        ConfigurationError: a feature is measured by this camera.
    """
    for feature in features:
        if isinstance(feature, RemoteCameraFeature) and feature.camera == fixed_cameras:
            raise ConfigurationError(
                f"{feature.name} cannot be servoed: camera '{fixed_cameras}' is fixed, and the arm "
                "does not move the camera's target; use features of another camera"
            )


def _compute_control_pose(goal: Goal, camera: str) -> np.ndarray:
    """Compute camera_T_control (4, 4) at the goal."""
    return relative_pose(
        *(goal.cameras[name].world_T_camera for name in (camera, goal.camera_name))
    )
