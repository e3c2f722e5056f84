"""Read the robot and cameras of an experiment, and choose the scheme of its loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.poses import inverse, relative_pose
from aras_visual_servo_camera.segmentation import BY_COLOUR
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
from .setup_context import SetupContext

if TYPE_CHECKING:
    from ..experiment.added_links import MountedTarget

IMAGE_ONLY_NEEDS = {Need.IMAGE, Need.KERNEL}  # exact features have none

SchemeWrapper = Callable[[Scheme | JointController], Scheme | JointController]


def read_context(
    experiment: Experiment,
    wrap_scheme: SchemeWrapper | None = None,
    has_unread_cameras: bool = True,
    has_depth: bool = False,
) -> SetupContext:
    """Read the files of an experiment and choose its scheme; arguments as of `assemble`."""
    experiment, robot = read_robot(experiment)
    eyes = read_cameras(experiment, robot)
    settings = make_loop_settings(experiment, robot)
    try:
        scheme = settings.make_scheme()
        if wrap_scheme is not None:
            scheme = wrap_scheme(scheme)
        read = settings.list_cameras(scheme)
        _check_is_fixed(experiment, read[0], robot)
        arm = robot.make_arm(read[0])
        rig = settings.make_camera_rig(dict.fromkeys(read), scheme)
        others = [name for name in eyes if name not in read] if has_unread_cameras else []
        eyes = {name: eyes[name] for name in [*read, *others]}
        places = locate_cameras(experiment, robot, eyes)
    except ConfigurationError as error:
        raise ExperimentError(str(error)) from error
    placed = experiment.target.placed_target
    targets = {
        name: eye.spec.target.placed_target if eye.spec.target else placed
        for name, eye in eyes.items()
    }
    segmentation = settings.make_segmentation()
    return SetupContext(
        experiment, robot, settings, scheme, arm, eyes,
        {name: observer.needs for name, observer in rig.observers.items()},
        placed, targets, places, has_depth,
        segmentation.label if segmentation.method == "label" else "",
    )  # fmt: skip


def read_robot(experiment: Experiment) -> tuple[Experiment, Robot]:
    """The experiment with the poses that links and calibrations give, and its robot."""
    check_settings(experiment)
    packages = PackagePath(experiment.robot.search)
    if experiment.target.is_link:
        from ..experiment.worlds import with_target_link

        experiment = with_target_link(experiment, packages)
    if any(camera.hand_eye is not None for camera in experiment.cameras.values()):
        from ..experiment.calibrated_cameras import with_fixed_cameras

        experiment = with_fixed_cameras(experiment, packages)
    experiment = experiment.with_absolute_start
    robot = _make_robot(experiment)
    if any(
        camera.calibration_offset.hand_eye is not None
        for camera in experiment.camera_specs.values()
    ):
        from ..experiment.calibrated_cameras import with_calibration_offsets

        experiment = with_calibration_offsets(experiment, robot)
        robot = _make_robot(experiment)
    return experiment, robot


def _make_robot(experiment: Experiment) -> Robot:
    carried: Mapping[str, MountedTarget] = {}
    if experiment.plant == "bullet":
        from .dynamic_arm_setup import find_mounted_targets  # the other plants need no physics

        carried = find_mounted_targets(experiment)
    return Robot(
        experiment.robot, experiment.camera_xyz, experiment.camera_rpy, experiment.friction,
        experiment.cameras, carried, experiment.hand_eye,
    )  # fmt: skip


def read_cameras(experiment: Experiment, robot: Robot) -> dict[str, CameraSetup]:
    """The cameras of an experiment by name, with what the robot's description says of them."""
    described = robot.read_camera_settings()
    eyes = {
        name: CameraSetup.read(name, spec, robot.packages, experiment.robot.cameras, described)
        for name, spec in experiment.camera_specs.items()
    }
    for eye in eyes.values():
        check_camera(eye, experiment)
    return eyes


def _check_is_fixed(experiment: Experiment, control: str, robot: Robot) -> None:
    """ExperimentError for a control camera that the arm moves as little as what it looks at."""
    stands = experiment.camera_specs[control].pose is not None
    if experiment.plant not in FREE_CAMERA_PLANTS:
        stands = bool(experiment.cameras) and robot.find_fixed_pose(control) is not None
    if stands:
        raise ExperimentError(
            f"camera '{control}' stands in the world, and the arm moves nothing that it sees: have "
            f"scheme '{experiment.scheme}' read a camera in the hand, or give the link that "
            "carries the target as robot.target_frame"
        )


def locate_cameras(
    experiment: Experiment, robot: Robot, cameras: Mapping[str, CameraSetup]
) -> dict[str, CameraPlacement]:
    """Places of the other cameras relative to the control camera, which is the first."""
    control, *others = cameras.values()
    flies, places = experiment.plant in FREE_CAMERA_PLANTS, {}
    for eye in others:
        stands = eye.spec.compute_pose() if flies and eye.spec.pose is not None else None
        if not flies:
            stands = robot.find_fixed_pose(eye.name)
        if stands is not None:
            places[eye.name] = CameraPlacement(stands, is_fixed=True)
        elif flies:
            places[eye.name] = CameraPlacement(
                relative_pose(control.spec.compute_pose(), eye.spec.compute_pose())
            )
        else:
            arm = robot.make_arm(control.name)
            other, rest = robot.make_camera_kinematics(eye.name, arm), np.zeros(len(arm.names))
            if isinstance(other, InverseCameraKinematics):
                # other_T = opposite @ inverse(control_T) @ place, whatever the joints
                apart = other.pose(rest) @ inverse(other.fixed_pose) @ arm.pose(rest)
                places[eye.name] = CameraPlacement(other.fixed_pose, target_T_control=apart)
            else:
                places[eye.name] = CameraPlacement(relative_pose(arm.pose(rest), other.pose(rest)))
    return places


def check_scheme(context: SetupContext) -> None:
    """ExperimentError for a scheme that can do nothing with what it will be given."""
    experiment, scheme = context.experiment, context.scheme
    for name in context.needs:
        place = context.placements.get(name)
        if place is not None and place.is_fixed:
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
            f"'{experiment.scheme}' needs: use area"
        )
    if experiment.plant == "ideal" and isinstance(scheme, JointController):
        raise ExperimentError(
            f"scheme '{experiment.scheme}' answers joints, the ideal camera has none: "
            "use plant bullet, chain or free"
        )
    if needs & IMAGE_ONLY_NEEDS and not experiment.has_images:
        raise ExperimentError(
            f"scheme '{experiment.scheme}' looks at pictures, and there are none with exact "
            "features: give features: images"
        )
    method = context.settings.make_segmentation().method
    apart = [name for name in context.cameras if context.has_own_target(name)]
    if method == "label" and apart:
        raise ExperimentError(
            f"label images tell one target, and camera '{apart[0]}' looks at one of "
            "its own: tell both by grey or colour"
        )
    if method in BY_COLOUR and experiment.plant != "bullet":
        raise ExperimentError(
            f"segmentation '{method}' needs colours, and the pictures of plant "
            f"'{experiment.plant}' are grey: take plant bullet, or tell the target by grey or "
            "label"
        )
