"""Makes the arm in Bullet's world: its cameras, the targets, and what is around it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from aras_visual_servo_base.poses import transform
from aras_visual_servo_controller.arm import Arm
from aras_visual_servo_controller.seeing.frame import Frame
from aras_visual_servo_controller.seeing.observation import SEGMENTED, Need

from ..asked.cameras import Eye
from ..asked.experiment import Experiment
from ..asked.imaging import drawn_settings
from ..asked.robots import OF, Carried
from ..asked.worlds import around
from ..errors import ExperimentError
from ..plants.bullet_arm import OCCLUDER, TARGET, BulletArm, Followed, ShownTarget
from ..targets.files import ABOVE, description_file, occluder_file
from .plant_making import WATCHES, PlantMaker

PATIENCE_NS = 1_000_000_000  # for the one picture that a goal is taught by
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


class ArmMaker(PlantMaker):
    """Makes the arm, and what it shows a camera at the goal."""

    def plant(self, arm: Arm, start: np.ndarray, exactly: bool = False) -> BulletArm:
        """The arm at joints (n,), rad or m; `exactly`: as for teaching a goal, without noise."""
        experiment, spec = self.experiment, self.experiment.target
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

    def _drawn(self, eye: Eye, exactly: bool) -> dict[str, Any]:
        """Settings of a camera whose pictures are rendered; `exactly`: without noise."""
        settings = drawn_settings(eye, self.experiment, exactly)
        needs = self.needs.get(eye.name, WATCHES)
        if self.depth or Need.DEPTH in needs:
            settings["depth"] = True
        if self.label and needs & SEGMENTED:
            settings["segmentation"] = True
        return settings

    def pictures(self, pose: np.ndarray, joints: Mapping[str, float]) -> dict[str, Frame]:
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
        found: dict[str, Frame] = {}
        try:
            while plant.time_ns < PATIENCE_NS:
                for reading in plant.advance(PATIENCE_NS):
                    if isinstance(reading, Frame) and reading.name in self.needs:
                        found.setdefault(reading.name, reading)
                if len(found) == len(self.needs):
                    return found
        finally:
            plant.close()
        raise ExperimentError("the camera delivers no picture within 1 s to teach the goal by")
