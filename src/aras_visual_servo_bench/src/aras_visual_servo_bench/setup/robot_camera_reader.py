"""Read the robot and cameras of an experiment, and choose the scheme of its loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.poses import inverse, relative_pose
from aras_visual_servo_camera.segmentation_settings import BY_COLOUR
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.observation.camera_rig import InverseCameraKinematics
from aras_visual_servo_controller.observation.observation import Need
from aras_visual_servo_controller.schemes import JointController, Scheme

from ..errors import ExperimentError
from ..experiment.cameras import CameraSetup, check_simultaneous_images
from ..experiment.experiment import FREE_CAMERA_PLANTS, Experiment
from ..experiment.loop_settings import make_loop_settings
from ..experiment.packages import PackagePath
from ..experiment.robots import Robot
from ..experiment.unused_settings import check_camera, check_settings
from ..plants.base import CameraPlacement
from ..targets.geometry import RoundTarget
from .run_setup import GoalImages, RunSetup

if TYPE_CHECKING:
    from ..experiment.added_links import MountedTarget

# data that can be measured only in an image, not computed from the geometry of the target
IMAGE_ONLY_NEEDS = {Need.IMAGE, Need.KERNEL}

SchemeWrapper = Callable[[Scheme | JointController], Scheme | JointController]


def read_context(
    experiment: Experiment,
    wrap_scheme: SchemeWrapper | None = None,
    has_unread_cameras: bool = True,
    has_depth: bool = False,
    goal_images: GoalImages | None = None,
) -> RunSetup:
    """Read the files of an experiment and choose its scheme.

    Args:
        wrap_scheme: function that receives the scheme of the experiment and returns the scheme to
            run; None: the scheme is used unchanged.
        has_unread_cameras: whether to include the cameras that the scheme does not read.
        has_depth: whether every camera delivers depth images, even if the scheme needs none.
        goal_images: see RunSetup.

    Raises:
        ExperimentError: the experiment cannot be run.
    """
    experiment, robot = read_robot(experiment)
    cameras = read_cameras(experiment, robot)
    settings = make_loop_settings(experiment, robot)
    try:
        scheme = settings.make_scheme()
        if wrap_scheme is not None:
            scheme = wrap_scheme(scheme)
        read = settings.list_cameras(scheme)
        _check_is_fixed(experiment, read[0], robot)
        arm = robot.make_arm(read[0])
        rig = settings.make_camera_rig(dict.fromkeys(read), scheme)
        others = [name for name in cameras if name not in read] if has_unread_cameras else []
        cameras = {name: cameras[name] for name in [*read, *others]}
        placements = locate_cameras(experiment, robot, cameras)
    except ConfigurationError as error:
        raise ExperimentError(str(error)) from error
    target = experiment.target.placed_target
    targets = {
        name: camera.spec.target.placed_target if camera.spec.target else target
        for name, camera in cameras.items()
    }
    segmentation = settings.make_segmentation()
    return RunSetup(
        experiment, robot, settings, scheme, arm, cameras,
        {name: observer.needs for name, observer in rig.observers.items()},
        target, targets, placements, has_depth,
        segmentation.label if segmentation.method == "label" else "",
        goal_images,
    )  # fmt: skip


def read_robot(experiment: Experiment) -> tuple[Experiment, Robot]:
    """Return the experiment, with links and calibration files converted to poses, and its robot.

    Raises:
        ExperimentError: a setting or a file is wrong.
    """
    check_settings(experiment)
    packages = PackagePath(experiment.robot.search)
    if experiment.target.is_link:
        from ..experiment.worlds import with_target_link

        experiment = with_target_link(experiment, packages)
    if any(camera.hand_eye is not None for camera in experiment.cameras.values()):
        from ..experiment.hand_eye_poses import with_fixed_cameras

        experiment = with_fixed_cameras(experiment, packages)
    experiment = experiment.with_absolute_start
    robot = _make_robot(experiment)
    if any(
        camera.calibration_offset.hand_eye is not None
        for camera in experiment.camera_specs.values()
    ):
        from ..experiment.hand_eye_poses import with_calibration_offsets

        experiment = with_calibration_offsets(experiment, robot)
        robot = _make_robot(experiment)
    return experiment, robot


def _make_robot(experiment: Experiment) -> Robot:
    mounted: Mapping[str, MountedTarget] = {}
    if experiment.plant == "bullet":
        # imported only here, because it loads the physics engine, which only plant 'bullet' needs
        from .dynamic_arm_setup import find_mounted_targets

        mounted = find_mounted_targets(experiment)
    return Robot(
        experiment.robot, experiment.camera_xyz, experiment.camera_rpy, experiment.friction,
        experiment.cameras, mounted, experiment.hand_eye,
    )  # fmt: skip


def read_cameras(experiment: Experiment, robot: Robot) -> dict[str, CameraSetup]:
    """Return the cameras of an experiment by name, with their settings in the robot description.

    Raises:
        ExperimentError: a setting or a file of a camera is wrong.
    """
    described = robot.read_camera_settings()
    cameras = {
        name: CameraSetup.read(name, spec, robot.packages, experiment.robot.cameras, described)
        for name, spec in experiment.camera_specs.items()
    }
    for camera in cameras.values():
        check_camera(camera, experiment)
    return cameras


def _check_is_fixed(experiment: Experiment, control: str, robot: Robot) -> None:
    """Check that the arm moves the control camera or its target.

    Raises:
        ExperimentError: both the camera and its target are fixed in the world.
    """
    is_fixed = experiment.camera_specs[control].pose is not None
    if experiment.plant not in FREE_CAMERA_PLANTS:
        is_fixed = bool(experiment.cameras) and robot.find_fixed_pose(control) is not None
    if is_fixed:
        raise ExperimentError(
            f"camera '{control}' is fixed in the world, and the arm does not move its target: "
            f"choose a camera in the hand for scheme '{experiment.scheme}', or set "
            "robot.target_frame to the link that carries the target"
        )


def locate_cameras(
    experiment: Experiment, robot: Robot, cameras: Mapping[str, CameraSetup]
) -> dict[str, CameraPlacement]:
    """Locate the other cameras relative to the control camera, which is the first in `cameras`.

    Returns:
        The placement of each other camera, by name.
    """
    control, *others = cameras.values()
    is_free, placements = experiment.plant in FREE_CAMERA_PLANTS, {}
    for camera in others:
        spec, name = camera.spec, camera.name
        fixed_pose = spec.compute_pose() if is_free and spec.pose is not None else None
        if not is_free:
            fixed_pose = robot.find_fixed_pose(name)
        if fixed_pose is not None:
            placements[name] = CameraPlacement(fixed_pose, is_fixed=True)
        elif is_free:
            placements[name] = CameraPlacement(
                relative_pose(control.spec.compute_pose(), spec.compute_pose())
            )
        else:
            arm = robot.make_arm(control.name)
            other, rest = robot.make_camera_kinematics(name, arm), np.zeros(len(arm.names))
            if isinstance(other, InverseCameraKinematics):
                # With the control camera's pose arm(q) at the joint positions q, the pose of a
                # camera that moves opposite to it is other(q) = target_T_control @ inverse(arm(q))
                # @ fixed_pose. At q = 0, this equation gives the constant target_T_control.
                target_T_control = other.pose(rest) @ inverse(other.fixed_pose) @ arm.pose(rest)
                placements[name] = CameraPlacement(
                    other.fixed_pose, target_T_control=target_T_control
                )
            else:
                placements[name] = CameraPlacement(relative_pose(arm.pose(rest), other.pose(rest)))
    return placements


def check_scheme(context: RunSetup) -> None:
    """Check that cameras, target and plant provide what the scheme needs.

    Raises:
        ExperimentError: the scheme cannot work with these cameras, this target or this plant.
    """
    experiment, scheme = context.experiment, context.scheme
    for name in context.needs:
        placement = context.placements.get(name)
        if placement is not None and placement.is_fixed:
            from aras_visual_servo_controller.features.remote_camera_feature import (
                check_controllability,
            )

            check_controllability(getattr(scheme, "features", ()), name)
    check_simultaneous_images(
        [context.cameras[name] for name in context.needs], experiment.duration
    )
    needs = frozenset().union(*context.needs.values())
    if Need.CORNERS in needs and isinstance(context.target.shape, RoundTarget):
        raise ExperimentError(
            f"target '{experiment.target.shape}' has no corners, which scheme "
            f"'{experiment.scheme}' needs: use a scheme without corners, such as area"
        )
    if experiment.plant == "ideal" and isinstance(scheme, JointController):
        raise ExperimentError(
            f"scheme '{experiment.scheme}' commands joints, but the ideal camera has none: "
            "use plant bullet, chain or free"
        )
    if needs & IMAGE_ONLY_NEEDS and not experiment.has_images:
        raise ExperimentError(
            f"scheme '{experiment.scheme}' needs images: set features to images"
        )
    method = context.settings.make_segmentation().method
    own_targets = [name for name in context.cameras if context.has_own_target(name)]
    if method == "label" and own_targets:
        raise ExperimentError(
            f"segmentation 'label' supports only one target, but camera '{own_targets[0]}' has "
            "its own target: segment by grey or colour"
        )
    if method in BY_COLOUR and experiment.plant != "bullet":
        raise ExperimentError(
            f"segmentation '{method}' needs colours, but the images of plant "
            f"'{experiment.plant}' are grey: use plant bullet, or segment by grey or label"
        )
