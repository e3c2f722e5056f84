"""From an experiment to the parts that run it: plant, loop, and where the goal truly is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from aras_visual_servo_base.poses import inverse, relative, transform
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.segmentation import BY_COLOUR
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.arm import Arm
from aras_visual_servo_controller.arm.limits import check_inside
from aras_visual_servo_controller.errors import ConfigurationError, ServoError, UnreachableError
from aras_visual_servo_controller.features.of_camera import check_steering
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.goals.starts import start_joints
from aras_visual_servo_controller.loop.servo import Servo
from aras_visual_servo_controller.schemes import JointController, Scheme
from aras_visual_servo_controller.seeing.frame import Frame
from aras_visual_servo_controller.seeing.observation import Need, Observation
from aras_visual_servo_controller.seeing.observer import observe
from aras_visual_servo_controller.seeing.rig import MovedBy, Rig, StandingCamera
from aras_visual_servo_controller.settings import Settings

from ..asked.calibrated_places import has_believed_places, with_believed_places, with_fixed_cameras
from ..asked.cameras import Eye, check_meeting
from ..asked.experiment import FLYING, CameraPose, Experiment, Sampler
from ..asked.loop_settings import named_goal, settings_of
from ..asked.packages import PackagePath
from ..asked.robots import Carried, Robot
from ..asked.unused_settings import check_camera, check_settings
from ..errors import ExperimentError, ViewError, log_once
from ..plants import Plant
from ..plants.base import Place
from ..plants.free_body import FreeBody
from ..targets.geometry import PlacedTarget, RoundTarget
from .goal_views import GoalViews
from .plant_making import PlantMaker
from .sampling import draw_start

if TYPE_CHECKING:
    from .postures import Postures

OF_PICTURES = {Need.IMAGE, Need.KERNEL}  # exact features have none


Wrap = Callable[[Scheme | JointController], Scheme | JointController]


@dataclass
class Assembly:
    """What a run needs.

    Attributes:
        plant: at its start. settings: of the loop. servo: the loop. rig: of its images.
        eyes: the cameras by name, the control camera first. goal: of the loop.
        goal_pose: world_T_camera (4, 4) where the true camera was when the goal was shown; of one
            that is computed, where it says. target: in the world.
        places: where the other cameras are beside the control camera.
        postures: of an arm; None of a camera that flies.
        notes: what a reader must know before believing the rest.
    """

    plant: Plant
    settings: Settings
    servo: Servo
    rig: Rig
    eyes: Mapping[str, Eye]
    goal: Goal
    goal_pose: np.ndarray
    target: PlacedTarget
    places: Mapping[str, Place]
    postures: Postures | None = None
    notes: tuple[str, ...] = ()

    @property
    def camera(self) -> CameraModel:
        """The control camera as the controller believes it."""
        return self.eyes[self.rig.control.name].believed

    @property
    def needs(self) -> frozenset[Need]:
        """What the loop wants of the control camera's image."""
        return self.rig.control.needs

    def observe(self, frame: Frame, joints: Any, commands: tuple = ()) -> Observation:
        """The observation of a frame, as the controller makes it.

        The ideal camera's kinematics are exact, and its plane counts as measured.
        """
        plane = None
        if self.plant.has_exact_plane:
            plane = self.servo.goal.plane_from(self.servo.arm.pose(joints.positions))
        return observe(frame, joints, self.rig.observers[frame.name],
                       self.eyes[frame.name].believed, commands, plane)  # fmt: skip


class _Builder:
    """Works out the parts one after the other; each is needed by the next."""

    def __init__(
        self, experiment: Experiment, wrap: Wrap | None = None, watched: bool = True,
        depth: bool = False,
    ) -> None:
        check_settings(experiment)
        packages = PackagePath(experiment.robot.search)
        if experiment.target.is_link:
            from ..asked.worlds import with_link

            experiment = with_link(experiment, packages)
        experiment = with_fixed_cameras(experiment, packages).placed
        self.robot = _robot(experiment)
        if has_believed_places(experiment.seen_by):
            experiment = with_believed_places(experiment, self.robot)
            self.robot = _robot(experiment)
        self.experiment = experiment
        described = self.robot.camera_settings()
        eyes = {
            name: Eye.of(name, spec, self.robot.packages, experiment.robot.cameras, described)
            for name, spec in experiment.seen_by.items()
        }
        for eye in eyes.values():
            check_camera(eye, experiment)
        self.loop_settings = settings_of(experiment, self.robot)
        try:
            self.scheme = self.loop_settings.make_scheme()
            if wrap is not None:
                self.scheme = wrap(self.scheme)
            read = self.loop_settings.read_by(self.scheme)
            _check_standing(experiment, read[0], self.robot)
            self.true_arm = self.robot.arm(read[0])
            rig = self.loop_settings.rig(dict.fromkeys(read), self.scheme)
        except ConfigurationError as error:
            raise ExperimentError(str(error)) from error
        self.needs = {name: observer.needs for name, observer in rig.observers.items()}
        seeing = [*read, *(name for name in eyes if watched and name not in read)]
        self.eyes = {name: eyes[name] for name in seeing}
        self.control = self.eyes[read[0]]
        segmentation = self.loop_settings.make_segmentation()
        kind = PlantMaker
        if experiment.plant == "bullet":
            from .arm_making import ArmMaker  # the others need no physics

            kind = ArmMaker

        self.plants = kind(
            experiment, self.robot, self.control,
            {name: self.eyes[name] for name in seeing[1:]}, experiment.target.placed, self.needs,
            depth,
            segmentation.label if segmentation.method == "label" else "",
        )  # fmt: skip
        self.target = self.plants.target_of(self.control.name)
        self.views = GoalViews(self.plants, self.loop_settings, self.scheme)

    def assemble(self) -> Assembly:
        """All of it; ExperimentError for what cannot be."""
        try:
            self._check_scheme()
            return self._assembled()
        except (ServoError, ViewError) as error:
            raise ExperimentError(str(error)) from error

    def _assembled(self) -> Assembly:
        pose, joints, named = self._wanted()
        arm, believed_arm = self._arms(pose)
        others = self._others(pose, believed_arm)
        posture = self._posture(pose, joints)
        goal = None
        if named is not None:
            goal = self._computed(named, {self.control.name: believed_arm, **others})
        if goal is None:
            rest = np.zeros(len(arm.names))
            mountings = {self.control.name: np.eye(4)}
            if believed_arm is not arm:
                mountings[self.control.name] = inverse(arm.pose(rest)) @ believed_arm.pose(rest)
            for name, other in others.items():
                true = self.plants.places[name].at(arm.pose(rest))
                mountings[name] = relative(true, other.pose(rest))
            name = "goal" if named is None else named.name
            there = {} if posture is None else dict(
                zip(arm.names, posture.tolist(), strict=True)
            )
            goal = self.views.taught(pose, mountings, there, name, others)
        else:
            pose = goal.world_T_camera
            if others:
                self.views.check(pose)
        goal = self._deeper(goal)
        start = self._start(arm, pose, posture)
        notes = self._faults(posture, bool(joints), start)
        resolver = None
        if self.experiment.plant == "ideal":
            from ..plants.ideal import ExactResolver

            resolver = ExactResolver(
                believed_arm, self.control.rate, self.experiment.ideal.speed
            )
        servo = self.loop_settings.build(
            believed_arm, goal, scheme=self.scheme, resolver=resolver
        )
        arms = {self.control.name: believed_arm, **others}
        rig = self.loop_settings.rig(arms, self.scheme, servo.goal)
        plant = self.plants.plant(arm, start)
        return Assembly(
            plant, self.loop_settings, servo, rig, self.eyes, goal, pose, self.target,
            self.plants.places, None if isinstance(arm, FreeBody) else self.plants.postures, notes,
        )  # fmt: skip

    def check(self) -> None:
        """ExperimentError for what is wrong before a world is made: names, files, poses."""
        experiment = self.experiment
        try:
            self._check_scheme()
            if not isinstance(experiment.start, Sampler | CameraPose):
                self._given_start()
            pose, _, named = self._wanted()
            if named is None:
                self.views.check(pose)
        except (ServoError, ViewError) as error:
            raise ExperimentError(str(error)) from error

    def _check_scheme(self) -> None:
        """ExperimentError for a scheme that can do nothing with what it will be given."""
        experiment = self.experiment
        for name in self.needs:
            place = self.plants.places.get(name)
            if place is not None and place.stands:
                check_steering(getattr(self.scheme, "features", ()), name)
        check_meeting([self.eyes[name] for name in self.needs], experiment.duration)
        needs = frozenset().union(*self.needs.values())
        if Need.CORNERS in needs and isinstance(self.target.shape, RoundTarget):
            raise ExperimentError(
                f"target '{experiment.target.shape}' has no corners, which scheme "
                f"'{experiment.scheme}' needs: use area"
            )
        if experiment.plant == "ideal" and isinstance(self.scheme, JointController):
            raise ExperimentError(
                f"scheme '{experiment.scheme}' answers joints, the ideal camera has none: "
                "use plant bullet, chain or free"
            )
        if needs & OF_PICTURES and not experiment.pictures:
            raise ExperimentError(
                f"scheme '{experiment.scheme}' looks at pictures, and there are none with exact "
                "features: give features: pictures"
            )
        method = self.loop_settings.make_segmentation().method
        if method == "label" and (apart := self.plants.seen_apart):
            raise ExperimentError(
                f"label images tell one target, and camera '{next(iter(apart))}' looks at one of "
                "its own: tell both by grey or colour"
            )
        if method in BY_COLOUR and experiment.plant != "bullet":
            raise ExperimentError(
                f"segmentation '{method}' needs colours, and the pictures of plant "
                f"'{experiment.plant}' are grey: take plant bullet, or tell the target by grey or "
                "label"
            )

    # -- goal ------------------------------------------------------------------------------

    def _arms(self, pose: np.ndarray) -> tuple[Arm | FreeBody, Arm | FreeBody]:
        """The true arm and the believed one; of a camera that flies, about the goal's pose."""
        believed = self.control.spec.believed
        if self.experiment.plant not in FLYING:
            return self.true_arm, self.robot.believed_arm(
                believed.xyz, believed.rpy, self.control.name
            )
        body = FreeBody(pose)
        if not believed.moved:
            return body, body
        return body, FreeBody(pose, transform(believed.xyz, believed.rpy))

    def _others(
        self, pose: np.ndarray, control: Arm | FreeBody
    ) -> dict[str, FreeBody | MovedBy]:
        """What is believed to move the other cameras that the scheme reads, by their names.

        Args:
            pose: world_T_camera (4, 4) of the true control camera at the goal.
        """
        others: dict[str, FreeBody | MovedBy] = {}
        for name in list(self.needs)[1:]:
            if self.experiment.plant not in FLYING:
                others[name] = self.robot.arm_of(name, control, believed=True)
                continue
            place, belief = self.plants.places[name], self.eyes[name].spec.believed
            seat = place.pose @ transform(belief.xyz, belief.rpy)
            others[name] = StandingCamera(seat) if place.stands else FreeBody(pose, seat)
        return others

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

    def _computed(
        self, named: Goal, arms: Mapping[str, FreeBody | MovedBy]
    ) -> Goal | None:
        """A named goal as the believed cameras see it; None where it lacks what the scheme
        needs, or was shown another target: the demo's plates in place of a solid, or the control
        camera's in place of a camera's own."""
        goal = named.for_cameras(arms)
        if any(n in self.plants.seen_apart and n not in named.cameras for n in self.needs):
            return None  # what it was shown is not what these look at
        if goal.target is not None and self.target.shape.is_solid:
            return None
        try:
            self.scheme.check(goal)
        except ConfigurationError:
            return None
        return goal

    def _posture(self, pose: np.ndarray, joints: Mapping[str, float]) -> np.ndarray | None:
        """Joints (n,) of the arm at the goal; None of a camera that flies, or where the arm cannot
        be there, which is an outcome.

        pose: world_T_camera (4, 4) there. joints: by name, where they are given.
        """
        if self.experiment.plant in FLYING:
            return None
        if joints:
            return np.array([joints[name] for name in self.true_arm.names])
        try:
            return self.plants.postures.at(pose)
        except UnreachableError:
            return None

    def _faults(
        self, goal: np.ndarray | None, given: bool, start: np.ndarray
    ) -> tuple[str, ...]:
        """What speaks against the joints (n,) at the goal and at the start; None: not known.

        given: whether the goal is given as joints.
        """
        if goal is None:
            return ()
        postures = self.plants.postures
        notes = postures.faults(goal, "goal", given)
        if not isinstance(self.experiment.start, Sampler):
            by_joints = not isinstance(self.experiment.start, CameraPose)
            notes += postures.faults(start, "start", by_joints)
        for note in notes:
            log_once(note)
        return tuple(notes)

    def _deeper(self, goal: Goal) -> Goal:
        """The goal with its depths as they are believed."""
        deeper = {
            name: _deeper(one, self.eyes[name].spec.believed.depth)
            for name, one in goal.cameras.items() if name in self.eyes
        }  # fmt: skip
        own = deeper.pop(self.control.name)
        return replace(own, others=deeper) if deeper else own

    # -- start -----------------------------------------------------------------------------

    def _start(
        self, arm: Arm | FreeBody, goal_pose: np.ndarray, posture: np.ndarray | None
    ) -> np.ndarray:
        """Joints (n,) at the start; `posture`: those at the goal, None: they are not known."""
        start = self.experiment.start
        if isinstance(start, Sampler):
            near = self._posture(goal_pose, {})
            near = np.zeros(len(arm.names)) if near is None else near
            return draw_start(
                start, arm, goal_pose, near, self.target, self.control.true,
                self.experiment.seed,
                [(self.plants.places[n], self.eyes[n].true, self.plants.target_of(n))
                 for n in list(self.needs)[1:]],
                None if isinstance(arm, FreeBody) else self.plants.postures.touched,
            )  # fmt: skip
        if isinstance(start, CameraPose):
            pose = transform(start.pose[:3], start.pose[3:])
            if isinstance(arm, FreeBody):
                return arm.coordinates(pose)
            return self.plants.postures.start(pose, posture)
        joints = self._given_start()
        if isinstance(arm, FreeBody):
            return arm.coordinates(self.true_arm.pose(joints))
        return joints

    def _given_start(self) -> np.ndarray:
        """Joints (n,) of a start that is given by name or as joints."""
        start = self.experiment.start
        joints = start_joints(start, self.true_arm, self.loop_settings.package)
        if joints is None:
            raise ExperimentError("start is 'none', but a plant has to begin somewhere")
        check_inside(joints, self.true_arm, "start")
        return joints


def check(experiment: Experiment) -> None:
    """ExperimentError for what cannot be of an experiment, found without making its plant."""
    _Builder(experiment).check()


def assemble(
    experiment: Experiment, wrap: Wrap | None = None, watched: bool = True, depth: bool = False
) -> Assembly:
    """The parts of an experiment, at its start.

    Args:
        wrap: makes the loop's scheme of the one that the experiment names; None: it is that.
        watched: whether cameras that the scheme does not read are there.
        depth: whether every camera gives depth images, needed or not.

    Raises:
        ExperimentError: what of it cannot be, and what would be right.
    """
    return _Builder(experiment, wrap, watched, depth).assemble()


def _robot(experiment: Experiment) -> Robot:
    carried: Mapping[str, Carried] = {}
    if experiment.plant == "bullet":
        from .arm_making import carried_by

        carried = carried_by(experiment)
    return Robot(
        experiment.robot, experiment.camera_xyz, experiment.camera_rpy, experiment.friction,
        experiment.cameras, carried, experiment.hand_eye,
    )  # fmt: skip


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


def _deeper(goal: Goal, factor: float) -> Goal:
    """The goal with its depth, and its plane's, multiplied: what a wrong belief makes of it."""
    if factor == 1.0:
        return goal
    depth = None if goal.depth is None else goal.depth * factor
    plane = None if goal.plane is None else Plane(*(part / factor for part in goal.plane))
    return replace(goal, depth=depth, plane=plane)

