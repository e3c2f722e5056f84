"""From an experiment to the parts that run it: plant, loop, and where the goal truly is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from aras_sim_bridge.description import Light
from aras_sim_bridge.description.lights import SUN
from aras_visual_servo_base.poses import transform
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.arm import Arm
from aras_visual_servo_controller.errors import ConfigurationError, ServoError, UnreachableError
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.goals.starts import start_joints
from aras_visual_servo_controller.loop.servo import Servo
from aras_visual_servo_controller.schemes import JointController, Scheme
from aras_visual_servo_controller.seeing.observation import Need, Observation, Observer
from aras_visual_servo_controller.settings import Settings

from ..errors import ExperimentError, ViewError
from ..plants import CameraReading, Plant
from ..plants.bullet_arm import BulletArm, ShownTarget
from ..plants.free_body import FreeBody
from ..plants.kinematic import FreeCamera, KinematicChain, Sight
from ..targets.files import description_file
from ..targets.geometry import PlacedTarget, RoundTarget
from ..targets.outlines import shape_of
from ..targets.textures import TexturedTarget
from . import cameras
from .experiment import FLYING, CameraPose, Experiment, Sampler, SunSpec
from .loop_settings import named_goal, named_scheme, settings_of
from .robots import Robot
from .sampling import draw_start

PATIENCE_NS = 1_000_000_000  # for the one picture that a goal is taught by
# What is taught from a picture as the loop will see it: its own errors are then none of the goal.
PICTURED = {Need.IMAGE, Need.CONTOUR, Need.CORNERS}
CHANCE = {"noise_stddev", "shot_noise", "drop_probability"}  # of a camera's effects
# The demo's target as the launch files put it into the world: a model whose origin lies there.
PLATES = "package://aras_visual_servo_gazebo/targets/aras.urdf"
PLATES_AT = (0.0, 0.0, 0.591)


@dataclass
class Assembly:
    """What a run needs.

    Attributes:
        plant: at its start. settings: of the loop. servo: the loop. observer: of its images.
        camera: as the controller believes it. goal: of the loop.
        goal_pose: world_T_camera (4, 4) where the true camera sees the goal. target: in the world.
    """

    plant: Plant
    settings: Settings
    servo: Servo
    observer: Observer
    camera: CameraModel
    goal: Goal
    goal_pose: np.ndarray
    target: PlacedTarget

    @property
    def needs(self) -> frozenset[Need]:
        """What the scheme wants of an image."""
        return self.observer.needs

    def observe(self, reading: CameraReading, joints: Any, commands: tuple = ()) -> Observation:
        """The observation of a camera's reading, as the controller makes it."""
        stamp = reading.stamp
        if reading.pictured:
            return self.observer.of_image(
                stamp, reading.picture, self.camera, joints, commands, reading.depth
            )
        return self.observer.of_exact(
            stamp, self.camera, joints, contour=reading.outline, points=reading.points,
            commands=commands,
        )  # fmt: skip


class _Builder:
    """Works out the parts one after the other; each is needed by the next."""

    def __init__(self, experiment: Experiment, scheme: Scheme | JointController | None) -> None:
        self.experiment = experiment = experiment.placed
        self.robot = Robot(
            experiment.robot, experiment.camera_xyz, experiment.camera_rpy, experiment.friction
        )
        self.settings = cameras.preset(
            experiment.camera, self.robot.packages, experiment.robot.cameras
        )
        self.true_arm = self.robot.arm()
        self.true_camera = cameras.model_of(self.settings)
        self.target = _target(experiment)
        self.scheme = named_scheme(experiment) if scheme is None else scheme
        self.loop_settings = settings_of(experiment, self.robot)
        self.needs = frozenset(self.scheme.needs)

    def assemble(self) -> Assembly:
        """All of it; ExperimentError for what cannot be."""
        if Need.CORNERS in self.needs and isinstance(self.target.shape, RoundTarget):
            raise ExperimentError(
                f"target '{self.experiment.target.shape}' has no corners, which scheme "
                f"'{self.experiment.scheme}' needs: use area"
            )
        try:
            return self._assembled()
        except (ServoError, ViewError) as error:
            raise ExperimentError(str(error)) from error

    def _assembled(self) -> Assembly:
        experiment, believed = self.experiment, self.experiment.believed
        goal = self._goal()
        if experiment.plant in FLYING:
            if goal.world_T_camera is None:
                goal = goal.for_arm(self.true_arm)
            arm: Arm | FreeBody = FreeBody(goal.world_T_camera)
            believed_arm = arm
            goal = replace(goal, joints={})
        else:
            arm = self.true_arm
            believed_arm = self.robot.believed_arm(believed.xyz, believed.rpy)
        goal = goal.for_arm(believed_arm)
        if goal.world_T_camera is None:
            raise ExperimentError(f"the goal {goal.name} says neither joints nor camera_pose")
        goal = self._taught(goal)
        goal_pose = np.array(goal.world_T_camera)
        if believed.depth != 1.0:
            goal = _deeper(goal, believed.depth)
        start = self._start(arm, goal_pose)
        camera = believed.camera(self.true_camera)
        if goal.camera == self.true_camera:  # it was taught here, by a camera believed like this
            goal = replace(goal, camera=camera)
        servo = self.loop_settings.build(believed_arm, goal, scheme=self.scheme)
        observer = self.loop_settings.observer(believed_arm, self.scheme)
        plant = self._plant(arm, start)
        return Assembly(
            plant, self.loop_settings, servo, observer, camera, goal, goal_pose, self.target
        )

    def check(self) -> None:
        """ExperimentError for what is wrong before a world is made: names, files, poses."""
        experiment = self.experiment
        try:
            if not isinstance(experiment.start, Sampler | CameraPose):
                self._start(self.true_arm, np.eye(4))
            if isinstance(experiment.goal, str):
                self._goal()
            elif not isinstance(experiment.goal, CameraPose):
                self._goal_joints()
            experiment.believed.camera(self.true_camera)
        except (ServoError, ViewError) as error:
            raise ExperimentError(str(error)) from error

    # -- goal ------------------------------------------------------------------------------

    def _goal(self) -> Goal:
        """The goal as named, or as taught at a pose."""
        goal = self.experiment.goal
        if isinstance(goal, str):
            return named_goal(self.experiment, self.loop_settings)
        if isinstance(goal, CameraPose):
            return self._teach(transform(goal.pose[:3], goal.pose[3:]), {})
        joints = self._goal_joints()
        by_name = dict(zip(self.true_arm.names, joints.tolist(), strict=True))
        return self._teach(self.true_arm.pose(joints), by_name)

    def _goal_joints(self) -> np.ndarray:
        """The joints (n,) that the goal is taught at, where it names joints."""
        try:
            joints = start_joints(self.experiment.goal, self.true_arm, self.loop_settings.package)
        except ConfigurationError as error:  # it speaks of a start, which it mostly is
            raise ExperimentError(str(error).replace("parameter ~start", "goal", 1)) from error
        self._within(joints, "goal")
        return joints

    def _taught(self, goal: Goal) -> Goal:
        """The goal, with what the scheme's features need of it, from its own pose."""
        try:
            self.scheme.check(goal)
        except ConfigurationError:
            seen = self._teach(goal.world_T_camera, goal.joints)
            return replace(seen, name=goal.name)
        return goal

    def _teach(self, pose: np.ndarray, joints: Mapping[str, float]) -> Goal:
        """What the true camera sees from a pose (4, 4), as a goal."""
        seen_from = self.target.seen_from(pose)
        plane = self.target.shape.plane(seen_from)
        observer = Observer(None, self.needs, tracker=self.loop_settings.make_tracker())
        if self.experiment.plant == "bullet" and self.experiment.pictures and self.needs & PICTURED:
            reading = self._picture(pose, joints)
        else:
            sight = self._sight(exactly=True)
            reading = sight.look(pose, 0, np.random.default_rng(0))
        if reading.pictured:
            observation = observer.of_image(
                0.0, reading.picture, self.true_camera, depth=reading.depth, plane=plane,
                world_T_camera=pose,
            )  # fmt: skip
        else:
            observation = observer.of_exact(
                0.0, self.true_camera, world_T_camera=pose, contour=reading.outline,
                points=reading.points, plane=plane,
            )  # fmt: skip
        depth = self.target.shape.depth(seen_from)
        goal = Goal.teach(self.scheme, observation, "goal", depth)
        return replace(goal, joints=dict(joints))

    def _picture(self, pose: np.ndarray, joints: Mapping[str, float]) -> CameraReading:
        """The first picture of an arm that stands at the goal."""
        if not joints:
            start = np.zeros(len(self.true_arm.names))
            found = self.true_arm.inverse(pose, start)
            joints = dict(zip(self.true_arm.names, found.tolist(), strict=True))
        q = np.array([joints[name] for name in self.true_arm.names])
        plant = self._plant(self.true_arm, q, exactly=True)
        try:
            while plant.time_ns < PATIENCE_NS:
                for reading in plant.advance(PATIENCE_NS):
                    if isinstance(reading, CameraReading):
                        return reading
        finally:
            plant.close()
        raise ExperimentError("the camera delivers no picture within 1 s to teach the goal by")

    # -- start -----------------------------------------------------------------------------

    def _start(self, arm: Arm | FreeBody, goal_pose: np.ndarray) -> np.ndarray:
        start = self.experiment.start
        if isinstance(start, Sampler):
            near = np.zeros(len(arm.names))
            if isinstance(arm, Arm):
                spec = self.experiment.robot
                frames = spec.camera_frame, spec.target_frame
                found = _joints_of(self.robot.urdf, frames, goal_pose.tobytes())
                # A goal out of reach is an outcome, and starts can be found all the same.
                near = near if found is None else np.array(found)
            return draw_start(
                start, arm, goal_pose, near, self.target, self.true_camera, self.experiment.seed
            )
        if isinstance(start, CameraPose):
            pose = transform(start.pose[:3], start.pose[3:])
            return arm.inverse(pose, np.zeros(len(arm.names)))
        joints = start_joints(start, self.true_arm, self.loop_settings.package)
        if joints is None:
            raise ExperimentError("start is 'none', but a plant has to begin somewhere")
        self._within(joints, "start")
        if isinstance(arm, FreeBody):
            return arm.coordinates(self.true_arm.pose(joints))
        return joints

    def _within(self, joints: np.ndarray, what: str) -> None:
        """ExperimentError for joints (n,) beyond their limits."""
        arm = self.true_arm
        for i in np.flatnonzero((joints < arm.lower) | (joints > arm.upper)):
            raise ExperimentError(
                f"{what} puts {arm.names[i]} at {joints[i]:.4f}, outside its limits "
                f"{arm.lower[i]:.4f} to {arm.upper[i]:.4f}"
            )

    # -- plant -----------------------------------------------------------------------------

    def _sight(self, exactly: bool = False) -> Sight:
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
            self.true_camera,
            target,
            float(self.settings.get("update_rate", 30.0)),
            pictures=pictures or (exactly and Need.IMAGE in self.needs),
            grey_noise=0.0 if exactly else experiment.noise,
            jitter=0.0 if exactly else experiment.jitter,
            depth=Need.DEPTH in self.needs,
            occluder=experiment.target.occluder,
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

    def _plant(self, arm: Arm | FreeBody, start: np.ndarray, exactly: bool = False) -> Plant:
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
                None if experiment.pictures else self._sight(), (_sun(experiment.sun),),
            )  # fmt: skip
        kind = FreeCamera if experiment.plant in FLYING else KinematicChain
        return kind(arm, start, self._sight(), lag=experiment.lag, seed=experiment.seed)


@lru_cache(maxsize=32)
def _joints_of(urdf: str, frames: tuple[str, str], pose: bytes) -> tuple[float, ...] | None:
    """Joints of an arm's camera pose (4, 4), None out of reach: all runs of a study share a goal.

    frames: of the camera and of the target.
    """
    arm = Arm.from_urdf(urdf, frames[0], target_frame=frames[1])
    try:
        return tuple(arm.inverse(np.frombuffer(pose).reshape(4, 4), np.zeros(len(arm.names))))
    except UnreachableError:
        return None


def check(experiment: Experiment) -> None:
    """ExperimentError for what cannot be of an experiment, found without making its plant."""
    _Builder(experiment, None).check()


def assemble(experiment: Experiment, scheme: Scheme | JointController | None = None) -> Assembly:
    """The parts of an experiment, at its start.

    Args:
        scheme: to be used in place of the one that the experiment names.

    Raises:
        ExperimentError: what of it cannot be, and what would be right.
    """
    return _Builder(experiment, scheme).assemble()



def _target(experiment: Experiment) -> PlacedTarget:
    spec = experiment.target
    shape = shape_of(spec.shape, spec.size)
    return PlacedTarget(shape, transform(spec.pose[:3], spec.pose[3:]), spec.motion)


def _sun(spec: SunSpec) -> Light:
    """The world's sun, of that direction and strength."""
    strength = (spec.diffuse,) * 3
    return replace(SUN, direction=spec.direction, diffuse=(*strength, 1.0))


def _deeper(goal: Goal, factor: float) -> Goal:
    """The goal with its depth, and its plane's, multiplied: what a wrong belief makes of it."""
    depth = None if goal.depth is None else goal.depth * factor
    plane = None if goal.plane is None else Plane(*(part / factor for part in goal.plane))
    return replace(goal, depth=depth, plane=plane)

