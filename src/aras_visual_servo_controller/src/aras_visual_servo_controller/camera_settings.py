"""Construction of the cameras of the control loop from the controller's parameters."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_base.settings import build
from aras_visual_servo_camera.errors import SegmentationError, VisionError
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.segmentation_settings import SegmentationSettings

from .errors import ConfigurationError
from .goals.goal import Goal
from .observation.camera_rig import CameraKinematics, CameraRig
from .observation.feature_observer import FeatureObserver
from .observation.observation import CAMERA, Need
from .parameters import (
    MODEL_TRACKER,
    OUTLINE_TRACKER,
    TRACKER_PARAMETERS,
    ControllerParameters,
)
from .schemes import JointController, Scheme

if TYPE_CHECKING:
    from aras_visual_servo_camera.trackers import Tracker


@dataclass(frozen=True)
class CameraSettings(ControllerParameters):
    """Parameters of the controller, with methods that construct its cameras and trackers."""

    def list_cameras(self, scheme: Scheme | JointController) -> tuple[str, ...]:
        """Return the names of the cameras that a scheme uses, in the order of `cameras`.

        The first name is that of the control camera.

        Raises:
            ConfigurationError: the scheme names an unknown camera.
        """
        known = tuple(self.cameras or (CAMERA,))
        read = {name or known[0] for name in scheme.cameras or ("",)}
        for name in read:
            if name not in known:
                raise ConfigurationError(
                    f"scheme '{self.scheme}' reads the unknown camera '{name}': "
                    f"{suggest(name, known)}"
                )
        return tuple(name for name in known if name in read)

    def make_camera_rig(
        self,
        arms: Mapping[str, CameraKinematics | None],
        scheme: Scheme | JointController,
        goal: Goal | None = None,
    ) -> CameraRig:
        """Construct the cameras that turn images into observations for a scheme.

        Args:
            arms: kinematics of each camera of the scheme, by the camera's name; None for a camera
                that no joint moves. The first one is the control camera.
            scheme: its `get_needs` determines what is measured in the images.
            goal: goal of the loop; None while a goal is being taught.
        """
        depth = frozenset((Need.DEPTH,)) if self.depth_image else frozenset()
        control = next(iter(arms))
        plane, goals = (self._make_outline_plane(), {}) if goal is None else (None, goal.cameras)
        return CameraRig(
            FeatureObserver(
                arm, scheme.get_needs(*(("", name) if name == control else (name,))) | depth,
                self.make_segmentation(),
                self.make_tracker(goals[name].marker if name in goals else ""),
                goals[name].compute_plane if name in goals else plane, name,
            )
            for name, arm in arms.items()
        )  # fmt: skip

    def _make_outline_plane(self) -> Callable[[np.ndarray], Plane] | None:
        """Return a function that computes the plane of the outline of the parameter `model`.

        The function maps world_T_camera to the plane, if the mesh model is at its initial pose.
        Return None if the parameter model_start does not give this pose; then a goal cannot be
        taught from the outline of the model.
        """
        if not self.model or "pose" not in self.model_start:
            return None
        from aras_visual_servo_camera.silhouette import OutlinePlaneFitter

        solid, place = self.make_tracker().tracking.solid, self.model_start["pose"]
        return OutlinePlaneFitter(
            solid.vertices, matrix_from_xyz_rpy(place[:3], place[3:]), Path(self.model).name
        ).compute_plane

    def make_segmentation(self, where: str = "parameter ~") -> SegmentationSettings:
        """Construct the segmentation of the target.

        Raises:
            ConfigurationError: the parameters are not valid; the message starts with `where`.
        """
        where = f"{where}segmentation"
        try:
            options = self.segmentation
            if self.marker and "marker" not in options:
                options = {"marker": self.marker, **options}
            found = build(SegmentationSettings, options, where, ConfigurationError)
        except SegmentationError as error:
            raise ConfigurationError(f"{where}: {error}") from error
        if found.component == "mask":
            raise ConfigurationError(
                f"{where}.component 'mask' is for the camera node, which has the mask image: set "
                "all, largest or nearest"
            )
        return found

    def make_tracker(self, marker: str = "") -> Tracker | None:
        """Construct the tracker that finds the points of the target.

        Return None if the corners of the outline are used.

        Args:
            marker: marker with which the goal was taught, used if the parameter `marker` is empty.

        Raises:
            ConfigurationError: there is no such tracker, or it does not accept a parameter.
        """
        name = self.tracker
        if self.model or "model" in re.split(r"[+@]", self.scheme):
            name = MODEL_TRACKER
        if name == OUTLINE_TRACKER:
            if self.tracker_options:
                raise ConfigurationError(
                    f"parameter ~tracker_options is {dict(self.tracker_options)}, but the tracker "
                    f"'{OUTLINE_TRACKER}' has no options: set ~tracker, or leave them out"
                )
            return None
        for key in TRACKER_PARAMETERS:
            if key in self.tracker_options:
                raise ConfigurationError(
                    f"parameter ~tracker_options.{key} is not allowed: set ~{key} instead"
                )
        from aras_visual_servo_camera.trackers import TRACKERS

        given = {key: getattr(self, key) for key in TRACKER_PARAMETERS}
        given["marker"] = self.marker or marker
        try:
            known = {parameter.name for parameter in TRACKERS.list_parameters(name)}
            options = {key: value for key, value in given.items() if key in known}
            return TRACKERS.create(name, **options, **self.tracker_options)
        except (VisionError, DescriptionError) as error:
            raise ConfigurationError(str(error)) from None
