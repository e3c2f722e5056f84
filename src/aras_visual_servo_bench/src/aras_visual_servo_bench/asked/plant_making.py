"""Makes the plant of an experiment: arm or camera, how it sees, and the target in its world."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from aras_sim_bridge.camera.effects import Effects
from aras_sim_bridge.camera.mounting import seed_of
from aras_sim_bridge.camera.shaking import Vibration
from aras_sim_bridge.camera.shutter import parts
from aras_visual_servo_base.poses import inverse, relative, transform
from aras_visual_servo_controller.arm import Arm
from aras_visual_servo_controller.seeing.observation import SEGMENTED, Need
from aras_visual_servo_controller.seeing.rig import OppositeCamera

from ..errors import ExperimentError
from ..plants import CameraReading, Plant
from ..plants.base import Place
from ..plants.bullet_arm import OCCLUDER, TARGET, BulletArm, Followed, ShownTarget
from ..plants.free_body import FreeBody
from ..plants.ideal import IdealCamera
from ..plants.kinematic import FreeCamera, KinematicChain
from ..plants.sight import Sight
from ..targets.files import ABOVE, description_file, occluder_file
from ..targets.geometry import PlacedTarget
from ..targets.textures import TexturedTarget
from .cameras import Eye, config_of
from .experiment import FLYING, Experiment
from .imaging import ON_FEATURES, drawn_settings, imaging_settings
from .postures import Postures
from .robots import OF, Carried, Robot
from .target_spec import TargetSpec
from .worlds import around, world_path

PATIENCE_NS = 1_000_000_000  # for the one picture that a goal is taught by
COLOUR = ("rgb", "bgr")  # encodings of pictures that without a renderer are grey
WATCHES: frozenset[Need] = frozenset()  # what a camera that steers nothing is asked for
# The demo's target as the launch files put it into the world: a model whose origin lies there.
PLATES = "package://aras_visual_servo_gazebo/targets/aras.urdf"
PLATES_AT = (0.0, 0.0, 0.591)


def carried_by(experiment: Experiment) -> dict[str, Carried]:
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


@dataclass(frozen=True, eq=False)
class PlantMaker:
    """Attributes:
        control: the control camera. others: the other cameras that are there, by name.
        target: the experiment's, in the world. needs: of the loop, by the name of the camera; none
            of one that only watches. depth: every camera gives depth images, whatever is needed.
        label: model, or 'model::link', that label images are to tell; '': none are wanted.
    """

    experiment: Experiment
    robot: Robot
    control: Eye
    others: Mapping[str, Eye]
    target: PlacedTarget
    needs: Mapping[str, frozenset[Need]]
    depth: bool = False
    label: str = ""

    @cached_property
    def places(self) -> dict[str, Place]:
        """Where the other cameras are beside the control camera."""
        own, places = self.control, {}
        flies = self.experiment.plant in FLYING
        arm = None if flies else self.robot.arm(own.name)
        for name, eye in self.others.items():
            stands = eye.spec.place() if flies and eye.spec.pose is not None else None
            if not flies:
                stands = self.robot.standing(name)
            if stands is not None:
                places[name] = Place(stands, stands=True)
            elif flies:
                places[name] = Place(relative(own.spec.place(), eye.spec.place()))
            else:
                other, rest = self.robot.arm_of(name, arm), np.zeros(len(arm.names))
                if isinstance(other, OppositeCamera):
                    # other_T = opposite @ inverse(control_T) @ place, whatever the joints
                    apart = other.pose(rest) @ inverse(other.place) @ arm.pose(rest)
                    places[name] = Place(other.place, opposite=apart)
                else:
                    places[name] = Place(relative(arm.pose(rest), other.pose(rest)))
        return places

    def spec_of(self, camera: str) -> TargetSpec:
        """What a camera looks at, as it was asked for."""
        own = self.seen_apart.get(camera)
        return self.experiment.target if own is None else own.spec.target

    def target_of(self, camera: str) -> PlacedTarget:
        """What a camera looks at, in the world, or in the link that carries it."""
        own = self.seen_apart.get(camera)
        return self.target if own is None else own.spec.target.placed

    @cached_property
    def postures(self) -> Postures:
        """Of the arm, with the control camera before the target."""
        experiment = self.experiment
        solid = experiment.plant == "bullet"
        target = self.control.spec.target or experiment.target
        return Postures.of(
            self.robot, self.control, target, solid and experiment.pictures, solid,
            world_path(experiment, self.robot.packages),
        )  # fmt: skip

    @property
    def unbounded(self) -> bool:
        """Whether what leaves the picture is seen all the same."""
        return self.experiment.plant == "ideal" and self.experiment.ideal.unbounded

    def sights(self) -> list[Sight]:
        """How plants without a world see, the control camera first."""
        return [self.sight(eye) for eye in (self.control, *self.others.values())]

    def sight(self, eye: Eye, exactly: bool = False) -> Sight:
        """How a camera sees without a world; `exactly`: as for teaching, without noise."""
        experiment, needs = self.experiment, self.needs.get(eye.name, WATCHES)
        pictures = experiment.pictures and not (exactly and experiment.plant == "bullet")
        pictures = pictures or (exactly and Need.IMAGE in needs)
        target, own = self.target_of(eye.name), eye.spec.target is not None
        on_it = TargetSpec() if own else experiment.target
        if on_it.perturbed and not exactly:
            if not isinstance(target.shape, TexturedTarget):
                raise ExperimentError(
                    f"target '{experiment.target.shape}' has no picture that could be perturbed: "
                    "use poster or a PNG"
                )
            target = replace(target, shape=target.shape.perturbed(experiment.seed))
        settings = imaging_settings(eye, experiment, exactly)
        config = config_of(settings)
        effects = config.effects
        if exactly:  # of one instant, as the camera is at rest
            effects = replace(effects, row_time=0.0, exposure_time=0.0)
        elif not pictures:  # of one instant for each row
            effects = Effects(**{key: getattr(effects, key) for key in ON_FEATURES})
        blind = None
        if config.cutoff_angle is not None:
            pixels = np.indices((config.height, config.width))[::-1].reshape(2, -1).T
            rays = config.model.unproject(pixels.astype(float))
            blind = ~np.isfinite(rays).all(axis=1).reshape(config.height, config.width)
        seed = settings.get("seed", seed_of(experiment.seed, eye.name))
        vibration = None if config.shake is None else Vibration(config.shake, seed)
        encoding = "mono8" if config.encoding.startswith(COLOUR) else config.encoding
        return Sight(
            eye.true,
            target,
            eye.rate,
            pictures=pictures,
            effects=effects,
            seed=seed,
            encoding=encoding,
            jitter=0.0 if exactly else experiment.jitter,
            depth=self.depth or config.depth or Need.DEPTH in needs,
            labelled=bool(self.label and needs & SEGMENTED),
            occluder=on_it.occluder,
            occluded=() if exactly and on_it.occluded else on_it.occluded,
            unbounded=self.unbounded,
            name=eye.name,
            place=self.places.get(eye.name),
            parts=parts(effects, config.height),
            vibration=vibration,
            blind=blind,
            # As the experiment says it: the description's are of pictures that are rendered.
            clip=(config.near, config.far) if {"near", "far"} & set(eye.overrides) else None,
        )  # fmt: skip

    def _spawned(self, exactly: bool) -> tuple[ShownTarget, ...]:
        """What is put into the simulated world: the targets, unless the robot brings them, and
        what comes and goes on the experiment's."""
        spec, robot = self.experiment.target, self.robot
        found = [
            ShownTarget(eye.spec.target.placed, description_file(eye.spec.target), name=OF + name)
            for name, eye in self.seen_apart.items()
            if not robot.target_frame(name) and not eye.spec.target.described
        ]
        if spec.brought or self.experiment.robot.target_frame:
            return tuple(found)
        if spec.shape == "aras":
            plates = robot.packages.file(PLATES)
            return (ShownTarget(self.target, plates, PLATES_AT), *found)
        seed = self.experiment.seed if spec.perturbed and not exactly else None
        found.append(ShownTarget(self.target, description_file(spec, seed)))
        if spec.occluded is not None and not exactly:
            cover = occluder_file(spec.occluder)
            found.append(
                ShownTarget(self.target, cover, (0.0, 0.0, ABOVE), spec.occluded, OCCLUDER)
            )
        return tuple(found)

    @property
    def seen_apart(self) -> dict[str, Eye]:
        """The cameras that look at a target of their own, by name."""
        eyes = {self.control.name: self.control, **self.others}
        return {name: eye for name, eye in eyes.items() if eye.spec.target is not None}

    def plant(self, arm: Arm | FreeBody, start: np.ndarray, exactly: bool = False) -> Plant:
        """The plant at joints (n,); `exactly`: as for teaching, without noise."""
        experiment, spec = self.experiment, self.experiment.target
        if experiment.plant == "bullet":
            joints = dict(zip(arm.names, start.tolist(), strict=True))
            return BulletArm(
                self.robot, self._drawn(self.control, exactly), joints, experiment.seed,
                experiment.renderer, experiment.traced, self._spawned(exactly),
                () if experiment.pictures else self.sights(),
                around(experiment, self.robot.packages, exactly),
                self.control.name if experiment.cameras else "",
                {name: self._drawn(eye, exactly) for name, eye in self.others.items()},
                experiment.sun.exposure, self.label,
                None if exactly or not spec.model else Followed(
                    spec.model, spec.link, self.target.course
                ),
            )  # fmt: skip
        if experiment.plant == "ideal":
            believed = experiment.believed
            body = FreeBody(arm.origin, transform(believed.xyz, believed.rpy))
            return IdealCamera(arm, body, start, self.sight(self.control), experiment.seed)
        kind = FreeCamera if experiment.plant == "free" else KinematicChain
        sight, *others = self.sights()
        return kind(
            arm, start, sight, lag=experiment.lag, seed=experiment.seed, others=others
        )  # fmt: skip

    def _drawn(self, eye: Eye, exactly: bool) -> dict[str, Any]:
        """Settings of a camera whose pictures are rendered; `exactly`: without noise."""
        settings = drawn_settings(eye, self.experiment, exactly)
        needs = self.needs.get(eye.name, WATCHES)
        if self.depth or Need.DEPTH in needs:
            settings["depth"] = True
        if self.label and needs & SEGMENTED:
            settings["segmentation"] = True
        return settings

    def pictures(self, pose: np.ndarray, joints: Mapping[str, float]) -> dict[str, CameraReading]:
        """The first picture of each camera that the loop reads, by name, of the arm that stands
        with its control camera at a pose (4, 4).

        joints: there, by name; empty: they are worked out.

        Raises:
            UnreachableError: the arm cannot be there. ExperimentError: no picture comes.
        """
        arm = self.robot.arm(self.control.name)
        q = np.array([joints[name] for name in arm.names]) if joints else self.postures.at(pose)
        plant = self.plant(arm, q, exactly=True)
        # An arm that efforts drive would sag until its controllers hold it, and the picture comes
        # after some hundredths of a second.
        plant.simulation.world.set_physics(gravity=(0.0, 0.0, 0.0))
        found: dict[str, CameraReading] = {}
        try:
            while plant.time_ns < PATIENCE_NS:
                for reading in plant.advance(PATIENCE_NS):
                    if isinstance(reading, CameraReading) and reading.camera in self.needs:
                        found.setdefault(reading.camera, reading)
                if len(found) == len(self.needs):
                    return found
        finally:
            plant.close()
        raise ExperimentError("the camera delivers no picture within 1 s to teach the goal by")
