"""Objects of a run that do not depend on its goal: robot, cameras, loop settings and scheme."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from aras_visual_servo_base.memory import ByteLimitedCache
from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.observation.frame import Frame
from aras_visual_servo_controller.observation.observation import Need
from aras_visual_servo_controller.schemes import JointController, Scheme
from aras_visual_servo_controller.settings import ControllerSettings

from ..experiment.cameras import CameraSetup
from ..experiment.experiment import FREE_CAMERA_PLANTS, Experiment
from ..experiment.robots import Robot
from ..plants.base import CameraPlacement
from ..targets.geometry import PlacedTarget
from ..targets.target_spec import TargetSpec

# Images of goals, by what determines them; each value has one frame for each camera.
GoalImages = ByteLimitedCache[tuple, Mapping[str, Frame]]


@dataclass(frozen=True, eq=False)
class RunSetup:
    """Robot, cameras, targets, loop settings and scheme of a run.

    Attributes:
        experiment: settings of the run, with files and links converted to poses.
        robot: robot of the experiment.
        settings: settings of the control loop.
        scheme: scheme of the control loop.
        arm: true kinematics of the control camera.
        cameras: cameras by name, the control camera first.
        needs: data that the scheme needs from each camera, by name, the control camera first; only
            cameras that the scheme reads.
        experiment_target: target of the experiment, with its pose in the world or in the link that
            carries it.
        targets: target of each camera, by the name of the camera.
        placements: pose of each other camera relative to the control camera, by name.
        has_depth: whether every camera delivers depth images, even if the scheme needs none.
        labelled_link: model or 'model::link' to mark as the target in label images; '': label
            images are not needed.
        goal_images: images of goals that were rendered for earlier runs; None if runs share none.
    """

    experiment: Experiment
    robot: Robot
    settings: ControllerSettings
    scheme: Scheme | JointController
    arm: Arm
    cameras: Mapping[str, CameraSetup]
    needs: Mapping[str, frozenset[Need]]
    experiment_target: PlacedTarget
    targets: Mapping[str, PlacedTarget]
    placements: Mapping[str, CameraPlacement]
    has_depth: bool = False
    labelled_link: str = ""
    goal_images: GoalImages | None = None

    @property
    def has_free_camera(self) -> bool:
        """True if the plant is a free camera without an arm."""
        return self.experiment.plant in FREE_CAMERA_PLANTS

    @property
    def control_camera(self) -> CameraSetup:
        """Camera whose motion the scheme controls; it is the first camera that the scheme reads."""
        return next(iter(self.cameras.values()))

    @property
    def target(self) -> PlacedTarget:
        """Target of the control camera."""
        return self.targets[self.control_camera.name]

    def has_own_target(self, camera: str) -> bool:
        """Return True if a camera observes its own target instead of the experiment's."""
        return camera in self.cameras and self.cameras[camera].spec.target is not None

    def find_target_spec(self, camera: str) -> TargetSpec:
        """Return the settings of the target that a camera observes."""
        return self.cameras[camera].spec.target or self.experiment.target

    def compute_camera_pose(self, camera: str, pose: np.ndarray) -> np.ndarray:
        """Return world_T_camera (4, 4) of a camera.

        pose: world_T_camera (4, 4) of the control camera.
        """
        placement = self.placements.get(camera)
        return pose if placement is None else placement.compute_pose(pose)
