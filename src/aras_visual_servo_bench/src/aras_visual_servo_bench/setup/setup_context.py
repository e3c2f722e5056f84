"""Parts of a run that do not depend on its goal: robot, cameras, loop settings and scheme."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.observation.observation import Need
from aras_visual_servo_controller.schemes import JointController, Scheme
from aras_visual_servo_controller.settings import Settings

from ..experiment.cameras import CameraSetup
from ..experiment.experiment import FREE_CAMERA_PLANTS, Experiment
from ..experiment.robots import Robot
from ..plants.base import CameraPlacement
from ..targets.geometry import PlacedTarget
from ..targets.target_spec import TargetSpec


@dataclass(frozen=True, eq=False)
class SetupContext:
    """Robot, cameras, targets, loop settings and scheme of a run.

    Attributes:
        experiment: with the poses that files and links give. arm: the true one.
        eyes: the cameras by name, the control camera first.
        needs: what the scheme needs of each camera that it reads, by name, in the same order.
        placed: the experiment's target, in the world or in the link that carries it.
        targets: what each camera looks at, likewise.
        places: of the other cameras relative to the control camera.
        depth: every camera delivers depth images, needed or not.
        label: model, or 'model::link', that label images show; '': none are needed.
    """

    experiment: Experiment
    robot: Robot
    settings: Settings
    scheme: Scheme | JointController
    arm: Arm
    cameras: Mapping[str, CameraSetup]
    needs: Mapping[str, frozenset[Need]]
    experiment_target: PlacedTarget
    targets: Mapping[str, PlacedTarget]
    placements: Mapping[str, CameraPlacement]
    has_depth: bool = False
    labelled_link: str = ""

    @property
    def has_free_camera(self) -> bool:
        """Whether the camera flies without an arm."""
        return self.experiment.plant in FREE_CAMERA_PLANTS

    @property
    def control_camera(self) -> CameraSetup:
        """The control camera."""
        return next(iter(self.cameras.values()))

    @property
    def target(self) -> PlacedTarget:
        """What the control camera looks at."""
        return self.targets[self.control_camera.name]

    def has_own_target(self, camera: str) -> bool:
        """Whether a camera looks at a target of its own."""
        return camera in self.cameras and self.cameras[camera].spec.target is not None

    def find_target_spec(self, camera: str) -> TargetSpec:
        """The settings of the target that a camera looks at."""
        return self.cameras[camera].spec.target or self.experiment.target

    def compute_camera_pose(self, camera: str, pose: np.ndarray) -> np.ndarray:
        """world_T_camera (4, 4) of a camera, with the control camera at world_T_camera (4, 4)."""
        place = self.placements.get(camera)
        return pose if place is None else place.compute_pose(pose)
