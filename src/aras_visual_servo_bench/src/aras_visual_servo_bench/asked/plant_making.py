"""Makes the plant of an experiment: arm or camera, how it sees, and the target in its world."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from aras_sim_bridge.description import Light
from aras_sim_bridge.description.lights import SUN
from aras_visual_servo_base.poses import transform
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.arm import Arm
from aras_visual_servo_controller.seeing.observation import Need

from ..errors import ExperimentError
from ..plants import CameraReading, Plant
from ..plants.bullet_arm import BulletArm, ShownTarget
from ..plants.free_body import FreeBody
from ..plants.ideal import IdealCamera
from ..plants.kinematic import FreeCamera, KinematicChain, Sight
from ..targets.files import description_file
from ..targets.geometry import PlacedTarget
from ..targets.textures import TexturedTarget
from .experiment import Experiment, SunSpec
from .robots import Robot

PATIENCE_NS = 1_000_000_000  # for the one picture that a goal is taught by
CHANCE = {"noise_stddev", "shot_noise", "drop_probability"}  # of a camera's effects
# The demo's target as the launch files put it into the world: a model whose origin lies there.
PLATES = "package://aras_visual_servo_gazebo/targets/aras.urdf"
PLATES_AT = (0.0, 0.0, 0.591)


@dataclass(frozen=True, eq=False)
class PlantMaker:
    """Attributes:
        settings: of the camera, as the simulator takes them. camera: the true one.
        target: in the world. needs: of the loop.
    """

    experiment: Experiment
    robot: Robot
    settings: Mapping[str, Any]
    camera: CameraModel
    target: PlacedTarget
    needs: frozenset[Need]

    @property
    def rate(self) -> float:
        """Pictures a second."""
        return float(self.settings.get("update_rate", 30.0))

    @property
    def unbounded(self) -> bool:
        """Whether what leaves the picture is seen all the same."""
        return self.experiment.plant == "ideal" and self.experiment.ideal.unbounded

    def sight(self, exactly: bool = False) -> Sight:
        """How plants without a renderer see; `exactly`: as for teaching, without noise."""
        experiment = self.experiment
        pictures = experiment.pictures and not (exactly and experiment.plant == "bullet")
        target = self.target
        if experiment.target.perturbed and not exactly:
            if not isinstance(target.shape, TexturedTarget):
                raise ExperimentError(
                    f"target '{experiment.target.shape}' has no picture that could be perturbed: "
                    "use poster or a PNG"
                )
            target = replace(target, shape=target.shape.perturbed(experiment.seed))
        return Sight(
            self.camera,
            target,
            self.rate,
            pictures=pictures or (exactly and Need.IMAGE in self.needs),
            grey_noise=0.0 if exactly else experiment.noise,
            jitter=0.0 if exactly else experiment.jitter,
            depth=Need.DEPTH in self.needs,
            occluder=experiment.target.occluder,
            unbounded=self.unbounded,
            drop=float(dict(self.settings.get("effects", {})).get("drop_probability", 0.0)),
        )

    def _spawned(self, exactly: bool) -> ShownTarget | None:
        """The target that is put into the simulated world, None where the robot brings its own."""
        spec = self.experiment.target
        if spec.described or self.experiment.robot.target_frame:
            return None
        if spec.shape == "aras":
            return ShownTarget(self.target, self.robot.packages.file(PLATES), PLATES_AT)
        seed = self.experiment.seed if spec.perturbed and not exactly else None
        return ShownTarget(self.target, description_file(spec, seed))

    def plant(self, arm: Arm | FreeBody, start: np.ndarray, exactly: bool = False) -> Plant:
        """The plant at joints (n,); `exactly`: as for teaching, without noise."""
        experiment = self.experiment
        if experiment.plant == "bullet":
            settings = dict(self.settings)
            effects = dict(settings.get("effects", {}))
            if exactly:  # one picture teaches the goal, and its noise would stay in it
                settings["effects"] = {k: v for k, v in effects.items() if k not in CHANCE}
            elif experiment.noise:
                settings["effects"] = {**effects, "noise_stddev": experiment.noise}
            if Need.DEPTH in self.needs:
                settings["depth"] = True
            joints = dict(zip(arm.names, start.tolist(), strict=True))
            return BulletArm(
                self.robot, settings, joints, experiment.seed, experiment.renderer,
                experiment.traced, self._spawned(exactly),
                None if experiment.pictures else self.sight(), (_sun(experiment.sun),),
            )  # fmt: skip
        if experiment.plant == "ideal":
            believed = experiment.believed
            body = FreeBody(arm.origin, transform(believed.xyz, believed.rpy))
            return IdealCamera(arm, body, start, self.sight(), experiment.seed)
        kind = FreeCamera if experiment.plant == "free" else KinematicChain
        return kind(arm, start, self.sight(), lag=experiment.lag, seed=experiment.seed)

    def picture(self, pose: np.ndarray, joints: Mapping[str, float]) -> CameraReading:
        """The first picture of the arm, standing with its camera at a pose (4, 4).

        joints: there, by name; empty: they are worked out.

        Raises:
            UnreachableError: the arm cannot be there. ExperimentError: no picture comes.
        """
        arm = self.robot.arm()
        q = np.array([joints[name] for name in arm.names]) if joints else arm.inverse(
            pose, np.zeros(len(arm.names))
        )
        plant = self.plant(arm, q, exactly=True)
        try:
            while plant.time_ns < PATIENCE_NS:
                for reading in plant.advance(PATIENCE_NS):
                    if isinstance(reading, CameraReading):
                        return reading
        finally:
            plant.close()
        raise ExperimentError("the camera delivers no picture within 1 s to teach the goal by")


def _sun(spec: SunSpec) -> Light:
    """The world's sun, of that direction and strength."""
    strength = (spec.diffuse,) * 3
    return replace(SUN, direction=spec.direction, diffuse=(*strength, 1.0))
