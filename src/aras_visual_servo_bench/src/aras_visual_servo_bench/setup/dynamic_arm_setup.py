"""Make the Bullet arm of a run with its cameras, targets and surroundings."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_controller.observation.frame import Frame

from ..errors import ExperimentError
from ..experiment.added_links import MountedTarget
from ..experiment.experiment import Experiment
from ..experiment.robots import TARGET_LINK_PREFIX
from ..experiment.worlds import read_surroundings
from ..plants.dynamic_arm import OCCLUDER, TARGET, DynamicArm, TargetLink, TargetModel
from ..targets.target_files import OCCLUDER_HEIGHT, write_description, write_occluder
from .imaging_setup import make_imaging_settings, make_rendered_settings
from .run_setup import RunSetup

# Keys of an experiment that do not change the image of its goal, which has no random effects.
WITHOUT_GOAL_IMAGE = (
    "start", "seed", "noise", "delay", "commands", "law", "gain", "duration",
    "time_after_convergence", "reached",
)  # fmt: skip
# longest simulated time until the image with which a goal is taught, ns
FIRST_IMAGE_TIMEOUT_NS = 1_000_000_000
# model of the demo's target, two plates
PLATES_FILE = "package://aras_visual_servo_gazebo/targets/aras.urdf"
PLATES_OFFSET = (0.0, 0.0, 0.591)  # origin of the model in PLATES_FILE, in the target frame, m


def find_mounted_targets(experiment: Experiment) -> dict[str, MountedTarget]:
    """Return the targets to fix to links of the Bullet arm, by the name of each target's new link.

    Targets that are already in the robot description are omitted.
    """
    targets = {TARGET: (experiment.target, experiment.robot.target_frame)}
    for name, camera in experiment.cameras.items():
        if camera.target is not None:
            targets[TARGET_LINK_PREFIX + name] = (
                camera.target,
                experiment.robot.find_carrier(camera),
            )
    return {
        name: MountedTarget(
            link, matrix_from_xyz_rpy(spec.pose[:3], spec.pose[3:]), write_description(spec)
        )
        for name, (spec, link) in targets.items()
        if experiment.plant == "bullet"
        and link
        and not spec.is_in_description
        and spec.shape != "aras"
    }


def make_dynamic_arm(
    context: RunSetup, start: np.ndarray, is_teaching: bool = False
) -> DynamicArm:
    """Make the simulated arm at the joint positions `start` (n,), rad or m.

    is_teaching: whether the arm is for teaching a goal: noise, occluder and changes of the light
        are then omitted.
    """
    experiment, spec, control = (
        context.experiment,
        context.experiment.target,
        context.control_camera,
    )
    return DynamicArm(
        context.robot, make_rendered_settings(context, control, is_teaching),
        dict(zip(context.arm.names, start.tolist(), strict=True)), experiment.seed,
        experiment.renderer, experiment.record_peak_speeds,
        _make_target_models(context, is_teaching),
        () if experiment.has_images else [make_imaging_settings(context, camera)
            for camera in context.cameras.values()],
        read_surroundings(experiment, context.robot.packages, is_teaching),
        control.name if experiment.cameras else "",
        {name: make_rendered_settings(context, camera, is_teaching)
         for name, camera in context.cameras.items() if camera is not control},
        experiment.sun.exposure, context.labelled_link,
        None if is_teaching or not spec.model else TargetLink(
            spec.model, spec.link, context.experiment_target.pose_history
        ),
    )  # fmt: skip


def take_goal_images(context: RunSetup, joints: np.ndarray) -> Mapping[str, Frame]:
    """Return the images of `take_first_images`, from an earlier run with the same goal if possible.
    """
    if context.goal_images is None:
        return take_first_images(context, joints)
    settings = context.experiment.to_mapping()
    key = (
        repr({name: value for name, value in settings.items() if name not in WITHOUT_GOAL_IMAGE}),
        context.robot.urdf, joints.tobytes(), tuple(context.needs.items()), context.has_depth,
        context.labelled_link,
    )  # fmt: skip
    return context.goal_images.get(key, partial(take_first_images, context, joints))


def take_first_images(context: RunSetup, joints: np.ndarray) -> dict[str, Frame]:
    """Take one image with each camera that the loop reads, with the arm at `joints` (n,).

    Returns:
        The images, by the name of the camera.

    Raises:
        ExperimentError: a camera delivers no image within 1 s.
    """
    plant = make_dynamic_arm(context, joints, is_teaching=True)
    # Without gravity, an arm with effort controllers stays at rest until the first image is taken,
    # which takes a few hundredths of a second.
    plant.simulation.world.set_physics(gravity=(0.0, 0.0, 0.0))
    found: dict[str, Frame] = {}
    try:
        while plant.time_ns < FIRST_IMAGE_TIMEOUT_NS:
            for reading in plant.advance(FIRST_IMAGE_TIMEOUT_NS):
                if isinstance(reading, Frame) and reading.name in context.needs:
                    found.setdefault(reading.name, reading)
            if len(found) == len(context.needs):
                return found
    finally:
        plant.close()
    raise ExperimentError(
        "goal: the camera delivers no image within 1 s, so the goal cannot be taught: increase the "
        "rate of the camera"
    )


def _make_target_models(context: RunSetup, is_teaching: bool) -> tuple[TargetModel, ...]:
    """Return the models to spawn in the simulated world: targets and the occluder.

    Targets that are on a link of the robot or in its description are omitted.
    """
    experiment, robot = context.experiment, context.robot
    spec = experiment.target
    found = [
        TargetModel(context.targets[name], write_description(camera.spec.target),
            name=TARGET_LINK_PREFIX + name)
        for name, camera in context.cameras.items()
        if camera.spec.target is not None
        and not robot.find_target_frame(name) and not camera.spec.target.is_in_description
    ]  # fmt: skip
    if spec.is_provided or experiment.robot.target_frame:
        return tuple(found)
    if spec.shape == "aras":
        return (
            TargetModel(
                context.experiment_target, robot.packages.resolve(PLATES_FILE), PLATES_OFFSET
            ),
            *found,
        )
    seed = experiment.seed if spec.perturbed and not is_teaching else None
    found.append(TargetModel(context.experiment_target, write_description(spec, seed)))
    if spec.occluded is not None and not is_teaching:
        cover = write_occluder(spec.occluder)
        found.append(
            TargetModel(
                context.experiment_target,
                cover,
                (0.0, 0.0, OCCLUDER_HEIGHT),
                spec.occluded,
                OCCLUDER,
            )
        )
    return tuple(found)
