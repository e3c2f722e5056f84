"""From an experiment to the parts that run it: plant, loop, and where the goal truly is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from aras_visual_servo_base.poses import inverse, transform
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.arm import Arm
from aras_visual_servo_controller.arm.limits import check_inside
from aras_visual_servo_controller.errors import ConfigurationError, ServoError, UnreachableError
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.goals.starts import start_joints
from aras_visual_servo_controller.loop.servo import Servo
from aras_visual_servo_controller.schemes import JointController, Scheme
from aras_visual_servo_controller.seeing.observation import Need, Observation, Observer
from aras_visual_servo_controller.settings import Settings

from ..errors import ExperimentError, ViewError
from ..plants import CameraReading, Plant
from ..plants.free_body import FreeBody
from ..plants.ideal import ExactResolver, IdealCamera
from ..targets.geometry import PlacedTarget, RoundTarget
from ..targets.outlines import shape_of
from . import cameras
from .experiment import FLYING, CameraPose, Experiment, Sampler
from .loop_settings import named_goal, settings_of
from .plant_making import PlantMaker
from .robots import Robot
from .sampling import draw_start

# What is taught from a picture as the loop will see it: its own errors are then none of the goal.
PICTURED = {Need.IMAGE, Need.CONTOUR, Need.CORNERS}
OF_PICTURES = {Need.IMAGE, Need.KERNEL}  # exact features have none
ELSEWHERE = "give a goal from where the camera sees it, or move the target"


Wrap = Callable[[Scheme | JointController], Scheme | JointController]


@dataclass
class Assembly:
    """What a run needs.

    Attributes:
        plant: at its start. settings: of the loop. servo: the loop. observer: of its images.
        camera: as the controller believes it. goal: of the loop.
        goal_pose: world_T_camera (4, 4) where the true camera was when the goal was shown; of one
            that is computed, where it says. target: in the world.
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
        """What the loop wants of an image."""
        return self.observer.needs

    def observe(self, reading: CameraReading, joints: Any, commands: tuple = ()) -> Observation:
        """The observation of a camera's reading, as the controller makes it.

        The ideal camera's kinematics are exact, and its plane counts as measured.
        """
        plane = None
        if isinstance(self.plant, IdealCamera):
            plane = self.servo.goal.plane_from(self.servo.arm.pose(joints.positions))
        return _observed(
            self.observer, reading, self.plant.camera, self.camera, joints=joints,
            commands=commands, plane=plane,
        )  # fmt: skip


def _observed(
    observer: Observer,
    reading: CameraReading,
    true_camera: CameraModel,
    camera: CameraModel,
    **known: Any,
) -> Observation:
    """What the true camera has delivered, read through the one that the controller believes in.

    Args:
        known: further arguments of `Observer.of_image` and `of_exact`.
    """
    if reading.pictured:
        return observer.of_image(
            reading.stamp, reading.picture, camera, depth=reading.depth, **known
        )
    return observer.of_exact(
        reading.stamp, camera,
        contour=cameras.read(reading.outline, true_camera, camera, closed=True),
        points=cameras.read(reading.points, true_camera, camera), **known,
    )  # fmt: skip


class _Builder:
    """Works out the parts one after the other; each is needed by the next."""

    def __init__(self, experiment: Experiment, wrap: Wrap | None = None) -> None:
        self.experiment = experiment = experiment.placed
        self.robot = Robot(
            experiment.robot, experiment.camera_xyz, experiment.camera_rpy, experiment.friction
        )
        settings = cameras.preset(
            experiment.camera, self.robot.packages, experiment.robot.cameras
        )
        self.true_arm = self.robot.arm()
        self.true_camera = cameras.model_of(settings)
        self.camera = experiment.believed.camera(self.true_camera)
        self.target = _target(experiment)
        self.loop_settings = settings_of(experiment, self.robot)
        try:
            self.scheme = self.loop_settings.make_scheme()
            if wrap is not None:
                self.scheme = wrap(self.scheme)
            self.needs = self.loop_settings.observer(self.true_arm, self.scheme).needs
        except ConfigurationError as error:
            raise ExperimentError(str(error)) from error
        self.plants = PlantMaker(
            experiment, self.robot, settings, self.true_camera, self.target, self.needs
        )

    def assemble(self) -> Assembly:
        """All of it; ExperimentError for what cannot be."""
        self._check_scheme()
        try:
            return self._assembled()
        except (ServoError, ViewError) as error:
            raise ExperimentError(str(error)) from error

    def _assembled(self) -> Assembly:
        pose, joints, named = self._wanted()
        arm, believed_arm = self._arms(pose)
        goal = None if named is None else self._computed(named, believed_arm)
        if goal is None:
            rest, mounting = np.zeros(len(arm.names)), np.eye(4)
            if believed_arm is not arm:
                mounting = inverse(arm.pose(rest)) @ believed_arm.pose(rest)
            goal = self._shown(pose, mounting, joints, "goal" if named is None else named.name)
        else:
            pose = goal.world_T_camera
        if self.experiment.believed.depth != 1.0:
            goal = _deeper(goal, self.experiment.believed.depth)
        start = self._start(arm, pose)
        resolver = None
        if self.experiment.plant == "ideal":
            resolver = ExactResolver(
                believed_arm, self.plants.rate, self.experiment.ideal.speed
            )
        servo = self.loop_settings.build(
            believed_arm, goal, scheme=self.scheme, resolver=resolver
        )
        observer = self.loop_settings.observer(believed_arm, self.scheme, servo.goal)
        plant = self.plants.plant(arm, start)
        return Assembly(
            plant, self.loop_settings, servo, observer, self.camera, goal, pose, self.target
        )

    def check(self) -> None:
        """ExperimentError for what is wrong before a world is made: names, files, poses."""
        experiment = self.experiment
        try:
            self._check_scheme()
            if not isinstance(experiment.start, Sampler | CameraPose):
                self._start(self.true_arm, np.eye(4))
            pose, _, named = self._wanted()
            if named is None:
                self._check_view(pose)
        except (ServoError, ViewError) as error:
            raise ExperimentError(str(error)) from error

    def _check_scheme(self) -> None:
        """ExperimentError for a scheme that can do nothing with what it will be given."""
        experiment = self.experiment
        if Need.CORNERS in self.needs and isinstance(self.target.shape, RoundTarget):
            raise ExperimentError(
                f"target '{experiment.target.shape}' has no corners, which scheme "
                f"'{experiment.scheme}' needs: use area"
            )
        if experiment.plant == "ideal" and isinstance(self.scheme, JointController):
            raise ExperimentError(
                f"scheme '{experiment.scheme}' answers joints, the ideal camera has none: "
                "use plant bullet, chain or free"
            )
        if self.needs & OF_PICTURES and not experiment.pictures:
            raise ExperimentError(
                f"scheme '{experiment.scheme}' looks at pictures, and there are none with exact "
                "features: give features: pictures"
            )

    def _check_view(self, pose: np.ndarray) -> None:
        """ExperimentError for a goal that is shown where the target is not in view."""
        try:
            outline = self.target.shape.outline(self.target.seen_from(pose))
        except ViewError as error:
            raise ExperimentError(f"goal: {error}: {ELSEWHERE}") from error
        if self.experiment.pictures:
            seen = (cameras.draw(outline, self.true_camera) < cameras.WHITE).any()
        else:
            seen = self.plants.unbounded or cameras.in_view(outline, self.true_camera, 0.0)
        if not seen:
            raise ExperimentError(
                f"the goal is shown where the target is not in the camera's view: {ELSEWHERE}"
            )

    # -- goal ------------------------------------------------------------------------------

    def _arms(self, pose: np.ndarray) -> tuple[Arm | FreeBody, Arm | FreeBody]:
        """The true arm and the believed one; of a camera that flies, about the goal's pose."""
        believed = self.experiment.believed
        if self.experiment.plant not in FLYING:
            return self.true_arm, self.robot.believed_arm(believed.xyz, believed.rpy)
        body = FreeBody(pose)
        if not believed.moved:
            return body, body
        return body, FreeBody(pose, transform(believed.xyz, believed.rpy))

    def _wanted(self) -> tuple[np.ndarray, Mapping[str, float], Goal | None]:
        """Where the true camera is at the goal, world_T_camera (4, 4); the joints there, by name,
        where they are known; and the goal that is named, None: it is shown."""
        wanted, flies = self.experiment.goal, self.experiment.plant in FLYING
        if isinstance(wanted, CameraPose):
            return transform(wanted.pose[:3], wanted.pose[3:]), {}, None
        if not isinstance(wanted, str):
            joints = self._goal_joints()
            named = dict(zip(self.true_arm.names, joints.tolist(), strict=True))
            return self.true_arm.pose(joints), {} if flies else named, None
        goal = here = named_goal(self.experiment, self.loop_settings)
        if not flies or goal.world_T_camera is None:
            here = goal.for_arm(self.true_arm)
        if here.world_T_camera is None:
            raise ExperimentError(f"the goal {goal.name} says neither joints nor camera_pose")
        if flies:
            goal = here = replace(here, joints={})
        return np.array(here.world_T_camera), here.joints, goal

    def _goal_joints(self) -> np.ndarray:
        """The joints (n,) that the goal is taught at, where it names joints."""
        try:
            joints = start_joints(self.experiment.goal, self.true_arm, self.loop_settings.package)
        except ConfigurationError as error:  # it speaks of a start, which it mostly is
            raise ExperimentError(str(error).replace("parameter ~start", "goal", 1)) from error
        check_inside(joints, self.true_arm, "goal")
        return joints

    def _computed(self, goal: Goal, arm: Arm | FreeBody) -> Goal | None:
        """A named goal as the believed arm sees it; None where it lacks what the scheme needs."""
        goal = goal.for_arm(arm)
        try:
            self.scheme.check(goal)
        except ConfigurationError:
            return None
        return goal

    def _shown(
        self, pose: np.ndarray, mounting: np.ndarray, joints: Mapping[str, float], name: str
    ) -> Goal:
        """What the controller makes of the true camera's view at the goal.

        Args:
            pose: world_T_camera (4, 4) of the true camera.
            mounting: (4, 4) of the believed camera in the true one.
        """
        self._check_view(pose)
        believed = pose @ mounting
        seen_from = self.target.seen_from(believed)
        if self.experiment.plant == "bullet" and self.experiment.pictures and self.needs & PICTURED:
            reading = self.plants.picture(pose, joints)
        else:
            reading = self.plants.sight(exactly=True).look(pose, 0, np.random.default_rng(0))
        observer = self.loop_settings.observer(None, self.scheme)
        observation = _observed(
            observer, reading, self.true_camera, self.camera, world_T_camera=believed,
            plane=self.target.shape.plane(seen_from),
        )  # fmt: skip
        goal = Goal.teach(self.scheme, observation, name, self.target.shape.depth(seen_from))
        return replace(goal, joints=dict(joints))

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
        check_inside(joints, self.true_arm, "start")
        if isinstance(arm, FreeBody):
            return arm.coordinates(self.true_arm.pose(joints))
        return joints


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
    _Builder(experiment).check()


def assemble(experiment: Experiment, wrap: Wrap | None = None) -> Assembly:
    """The parts of an experiment, at its start.

    Args:
        wrap: makes the loop's scheme of the one that the experiment names; None: it is that.

    Raises:
        ExperimentError: what of it cannot be, and what would be right.
    """
    return _Builder(experiment, wrap).assemble()


def _target(experiment: Experiment) -> PlacedTarget:
    spec = experiment.target
    shape = shape_of(spec.shape, spec.size)
    return PlacedTarget(shape, transform(spec.pose[:3], spec.pose[3:]), spec.motion)


def _deeper(goal: Goal, factor: float) -> Goal:
    """The goal with its depth, and its plane's, multiplied: what a wrong belief makes of it."""
    depth = None if goal.depth is None else goal.depth * factor
    plane = None if goal.plane is None else Plane(*(part / factor for part in goal.plane))
    return replace(goal, depth=depth, plane=plane)

