"""The Bullet arm of a run: its cameras, the targets, and what is around it."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.poses import transform
from aras_visual_servo_controller.seeing.frame import Frame

from ..asked.added_links import Carried
from ..asked.experiment import Experiment
from ..asked.robots import OF
from ..asked.worlds import around
from ..errors import ExperimentError
from ..plants.bullet_arm import OCCLUDER, TARGET, BulletArm, Followed, ShownTarget
from ..targets.files import ABOVE, description_file, occluder_file
from .setup_context import SetupContext
from .sights import make_sight, rendered_settings

PATIENCE_NS = 1_000_000_000  # for the one picture that a goal is taught by
# The demo's target as the launch files put it into the world: a model whose origin lies there.
PLATES = "package://aras_visual_servo_gazebo/targets/aras.urdf"
PLATES_AT = (0.0, 0.0, 0.591)


def carried_targets(experiment: Experiment) -> dict[str, Carried]:
    """The targets that are put onto links of the Bullet arm, by the names of their own links; those
    that its description has itself are none of them."""
    looked_at = {TARGET: (experiment.target, experiment.robot.target_frame)}
    for name, camera in experiment.cameras.items():
        if camera.target is not None:
            looked_at[OF + name] = camera.target, experiment.robot.carrier_for(camera)
    return {
        name: Carried(link, transform(spec.pose[:3], spec.pose[3:]), description_file(spec))
        for name, (spec, link) in looked_at.items()
        if experiment.plant == "bullet" and link and not spec.described and spec.shape != "aras"
    }


def make_bullet_arm(context: SetupContext, start: np.ndarray, exactly: bool = False) -> BulletArm:
    """The arm at joints (n,), rad or m; `exactly`: as for teaching a goal, without noise."""
    experiment, spec, control = context.experiment, context.experiment.target, context.control
    return BulletArm(
        context.robot, rendered_settings(context, control, exactly),
        dict(zip(context.arm.names, start.tolist(), strict=True)), experiment.seed,
        experiment.renderer, experiment.traced, _spawned_targets(context, exactly),
        () if experiment.pictures else [make_sight(context, eye) for eye in context.eyes.values()],
        around(experiment, context.robot.packages, exactly),
        control.name if experiment.cameras else "",
        {name: rendered_settings(context, eye, exactly)
         for name, eye in context.eyes.items() if eye is not control},
        experiment.sun.exposure, context.label,
        None if exactly or not spec.model else Followed(
            spec.model, spec.link, context.placed.course
        ),
    )  # fmt: skip


def take_first_images(context: SetupContext, joints: np.ndarray) -> dict[str, Frame]:
    """The first image of each camera that the loop reads, by name, of an arm at joints (n,).

    Raises:
        ExperimentError: no image comes.
    """
    plant = make_bullet_arm(context, joints, exactly=True)
    # An arm that efforts drive would sag until its controllers hold it, and the picture comes
    # after some hundredths of a second.
    plant.simulation.world.set_physics(gravity=(0.0, 0.0, 0.0))
    found: dict[str, Frame] = {}
    try:
        while plant.time_ns < PATIENCE_NS:
            for reading in plant.advance(PATIENCE_NS):
                if isinstance(reading, Frame) and reading.name in context.needs:
                    found.setdefault(reading.name, reading)
            if len(found) == len(context.needs):
                return found
    finally:
        plant.close()
    raise ExperimentError("the camera delivers no picture within 1 s to teach the goal by")


def _spawned_targets(context: SetupContext, exactly: bool) -> tuple[ShownTarget, ...]:
    """What is put into the simulated world: the targets, unless the robot brings them, and what
    comes and goes on the experiment's."""
    experiment, robot = context.experiment, context.robot
    spec = experiment.target
    found = [
        ShownTarget(context.targets[name], description_file(eye.spec.target), name=OF + name)
        for name, eye in context.eyes.items()
        if eye.spec.target is not None
        and not robot.target_frame(name) and not eye.spec.target.described
    ]  # fmt: skip
    if spec.brought or experiment.robot.target_frame:
        return tuple(found)
    if spec.shape == "aras":
        return (ShownTarget(context.placed, robot.packages.file(PLATES), PLATES_AT), *found)
    seed = experiment.seed if spec.perturbed and not exactly else None
    found.append(ShownTarget(context.placed, description_file(spec, seed)))
    if spec.occluded is not None and not exactly:
        cover = occluder_file(spec.occluder)
        found.append(
            ShownTarget(context.placed, cover, (0.0, 0.0, ABOVE), spec.occluded, OCCLUDER)
        )
    return tuple(found)
