"""Makes the plant of an experiment: arm or camera, how it sees, and the target in its world."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from aras_sim_bridge.camera.config import seed_of
from aras_sim_bridge.camera.effects import Effects
from aras_sim_bridge.camera.shaking import Vibration
from aras_sim_bridge.camera.shutter import parts
from aras_visual_servo_base.poses import inverse, relative, transform
from aras_visual_servo_controller.arm import Arm
from aras_visual_servo_controller.seeing.observation import SEGMENTED, Need
from aras_visual_servo_controller.seeing.rig import OppositeCamera

from ..asked.cameras import Eye, config_of
from ..asked.experiment import FLYING, Experiment
from ..asked.imaging import ON_FEATURES, imaging_settings
from ..asked.robots import Robot
from ..errors import ExperimentError
from ..plants import Plant
from ..plants.base import Place
from ..plants.free_body import FreeBody
from ..plants.kinematic import FreeCamera, KinematicChain
from ..plants.sight import Sight
from ..targets.geometry import PlacedTarget
from ..targets.target_spec import TargetSpec

if TYPE_CHECKING:
    from .postures import Postures

COLOUR = ("rgb", "bgr")  # encodings of pictures that without a renderer are grey
WATCHES: frozenset[Need] = frozenset()  # what a camera that steers nothing is asked for


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
        from ..asked.worlds import world_path
        from .postures import Postures

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
            if not target.shape.is_textured:
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

    @property
    def seen_apart(self) -> dict[str, Eye]:
        """The cameras that look at a target of their own, by name."""
        eyes = {self.control.name: self.control, **self.others}
        return {name: eye for name, eye in eyes.items() if eye.spec.target is not None}

    def plant(self, arm: Arm | FreeBody, start: np.ndarray, exactly: bool = False) -> Plant:
        """The plant at joints (n,); `exactly`: as for teaching, without noise."""
        experiment = self.experiment
        if experiment.plant == "ideal":
            from ..plants.ideal import IdealCamera

            believed = experiment.believed
            body = FreeBody(arm.origin, transform(believed.xyz, believed.rpy))
            return IdealCamera(arm, body, start, self.sight(self.control), experiment.seed)
        kind = FreeCamera if experiment.plant == "free" else KinematicChain
        sight, *others = self.sights()
        return kind(
            arm, start, sight, lag=experiment.lag, seed=experiment.seed, others=others
        )  # fmt: skip
