"""Read the robot and cameras of an experiment, and choose the scheme of its loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.poses import inverse, relative
from aras_visual_servo_camera.segmentation import BY_COLOUR
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.schemes import JointController, Scheme
from aras_visual_servo_controller.seeing.observation import Need
from aras_visual_servo_controller.seeing.rig import OppositeCamera

from ..asked.cameras import Eye, check_meeting
from ..asked.experiment import FLYING, Experiment
from ..asked.loop_settings import settings_of
from ..asked.packages import PackagePath
from ..asked.robots import Robot
from ..asked.unused_settings import check_camera, check_settings
from ..errors import ExperimentError
from ..plants.base import Place
from ..targets.geometry import RoundTarget
from .setup_context import SetupContext

if TYPE_CHECKING:
    from ..asked.added_links import Carried

OF_PICTURES = {Need.IMAGE, Need.KERNEL}  # exact features have none

Wrap = Callable[[Scheme | JointController], Scheme | JointController]


def read_context(
    experiment: Experiment, wrap: Wrap | None = None, watched: bool = True, depth: bool = False
) -> SetupContext:
    """Read the files of an experiment and choose its scheme; arguments as of `assemble`."""
    experiment, robot = read_robot(experiment)
    eyes = read_cameras(experiment, robot)
    settings = settings_of(experiment, robot)
    try:
        scheme = settings.make_scheme()
        if wrap is not None:
            scheme = wrap(scheme)
        read = settings.read_by(scheme)
        _check_standing(experiment, read[0], robot)
        arm = robot.arm(read[0])
        rig = settings.rig(dict.fromkeys(read), scheme)
        others = [name for name in eyes if name not in read] if watched else []
        eyes = {name: eyes[name] for name in [*read, *others]}
        places = locate_cameras(experiment, robot, eyes)
    except ConfigurationError as error:
        raise ExperimentError(str(error)) from error
    placed = experiment.target.placed
    targets = {
        name: eye.spec.target.placed if eye.spec.target else placed for name, eye in eyes.items()
    }
    segmentation = settings.make_segmentation()
    return SetupContext(
        experiment, robot, settings, scheme, arm, eyes,
        {name: observer.needs for name, observer in rig.observers.items()},
        placed, targets, places, depth,
        segmentation.label if segmentation.method == "label" else "",
    )  # fmt: skip


def read_robot(experiment: Experiment) -> tuple[Experiment, Robot]:
    """The experiment with the poses that links and calibrations give, and its robot."""
    check_settings(experiment)
    packages = PackagePath(experiment.robot.search)
    if experiment.target.is_link:
        from ..asked.worlds import with_link

        experiment = with_link(experiment, packages)
    if any(camera.hand_eye is not None for camera in experiment.cameras.values()):
        from ..asked.calibrated_places import with_fixed_cameras

        experiment = with_fixed_cameras(experiment, packages)
    experiment = experiment.placed
    robot = _robot(experiment)
    if any(camera.believed.hand_eye is not None for camera in experiment.seen_by.values()):
        from ..asked.calibrated_places import with_believed_places

        experiment = with_believed_places(experiment, robot)
        robot = _robot(experiment)
    return experiment, robot


def _robot(experiment: Experiment) -> Robot:
    carried: Mapping[str, Carried] = {}
    if experiment.plant == "bullet":
        from .bullet_setup import carried_targets  # the other plants need no physics

        carried = carried_targets(experiment)
    return Robot(
        experiment.robot, experiment.camera_xyz, experiment.camera_rpy, experiment.friction,
        experiment.cameras, carried, experiment.hand_eye,
    )  # fmt: skip


def read_cameras(experiment: Experiment, robot: Robot) -> dict[str, Eye]:
    """The cameras of an experiment by name, with what the robot's description says of them."""
    described = robot.camera_settings()
    eyes = {
        name: Eye.of(name, spec, robot.packages, experiment.robot.cameras, described)
        for name, spec in experiment.seen_by.items()
    }
    for eye in eyes.values():
        check_camera(eye, experiment)
    return eyes


def _check_standing(experiment: Experiment, control: str, robot: Robot) -> None:
    """ExperimentError for a control camera that the arm moves as little as what it looks at."""
    stands = experiment.seen_by[control].pose is not None
    if experiment.plant not in FLYING:
        stands = bool(experiment.cameras) and robot.standing(control) is not None
    if stands:
        raise ExperimentError(
            f"camera '{control}' stands in the world, and the arm moves nothing that it sees: have "
            f"scheme '{experiment.scheme}' read a camera in the hand, or give the link that "
            "carries the target as robot.target_frame"
        )


def locate_cameras(
    experiment: Experiment, robot: Robot, eyes: Mapping[str, Eye]
) -> dict[str, Place]:
    """Places of the other cameras relative to the control camera, which is the first."""
    control, *others = eyes.values()
    flies, places = experiment.plant in FLYING, {}
    for eye in others:
        stands = eye.spec.place() if flies and eye.spec.pose is not None else None
        if not flies:
            stands = robot.standing(eye.name)
        if stands is not None:
            places[eye.name] = Place(stands, stands=True)
        elif flies:
            places[eye.name] = Place(relative(control.spec.place(), eye.spec.place()))
        else:
            arm = robot.arm(control.name)
            other, rest = robot.arm_of(eye.name, arm), np.zeros(len(arm.names))
            if isinstance(other, OppositeCamera):
                # other_T = opposite @ inverse(control_T) @ place, whatever the joints
                apart = other.pose(rest) @ inverse(other.place) @ arm.pose(rest)
                places[eye.name] = Place(other.place, opposite=apart)
            else:
                places[eye.name] = Place(relative(arm.pose(rest), other.pose(rest)))
    return places


def check_scheme(context: SetupContext) -> None:
    """ExperimentError for a scheme that can do nothing with what it will be given."""
    experiment, scheme = context.experiment, context.scheme
    for name in context.needs:
        place = context.places.get(name)
        if place is not None and place.stands:
            from aras_visual_servo_controller.features.of_camera import check_steering

            check_steering(getattr(scheme, "features", ()), name)
    check_meeting([context.eyes[name] for name in context.needs], experiment.duration)
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
    if needs & OF_PICTURES and not experiment.pictures:
        raise ExperimentError(
            f"scheme '{experiment.scheme}' looks at pictures, and there are none with exact "
            "features: give features: pictures"
        )
    method = context.settings.make_segmentation().method
    apart = [name for name in context.eyes if context.has_own_target(name)]
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
