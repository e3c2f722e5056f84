"""Build a run from an experiment: robot, cameras, loop, goal, start and plant.

The functions stand in the order in which `assemble` calls them; `read_context` comes first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from aras_visual_servo_base.poses import transform
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.arm import Arm
from aras_visual_servo_controller.arm.limits import check_inside
from aras_visual_servo_controller.errors import ConfigurationError, ServoError, UnreachableError
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.goals.starts import start_joints
from aras_visual_servo_controller.loop.servo import Servo
from aras_visual_servo_controller.seeing.frame import Frame
from aras_visual_servo_controller.seeing.observation import Need, Observation
from aras_visual_servo_controller.seeing.observer import observe
from aras_visual_servo_controller.seeing.rig import MovedBy, Rig, StandingCamera
from aras_visual_servo_controller.settings import Settings

from ..asked.cameras import Eye
from ..asked.experiment import CameraPose, Experiment, Sampler
from ..asked.loop_settings import named_goal
from ..errors import ExperimentError, ViewError, log_once
from ..plants.base import Place, Plant
from ..plants.free_body import FreeBody
from ..plants.kinematic import FreeCamera, KinematicChain
from ..targets.geometry import PlacedTarget
from .read_context import Wrap, check_scheme, read_context
from .setup_context import SetupContext
from .sights import make_sight

if TYPE_CHECKING:
    from .postures import Postures


@dataclass
class Assembly:
    """The parts of a run, made by `assemble`.

    Attributes:
        plant: arm or camera that moves, at its start. settings: of the servo loop. servo: the loop.
        rig: makes the observations of its cameras.
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


def assemble(
    experiment: Experiment, wrap: Wrap | None = None, watched: bool = True, depth: bool = False
) -> Assembly:
    """Make the parts of an experiment, at its start: plant, servo loop, cameras, goal.

    Args:
        experiment: what is run.
        wrap: function that replaces the scheme that the experiment names by another one, for
            instance one that records it; None: the scheme itself.
        watched: whether cameras that the scheme does not read exist.
        depth: whether every camera has depth images, needed or not.

    Returns:
        The parts, for a `Loop`.

    Raises:
        ExperimentError: it cannot be run, with the key that is wrong and what would be right.
    """
    context = read_context(experiment, wrap, watched, depth)
    try:
        check_scheme(context)
        shown = read_goal(context)
        arm, believed = make_arms(context, shown.pose)
        others = believed_others(context, shown.pose, believed)
        postures = None if context.flies else make_postures(context)
        goal_joints = find_goal_joints(context, postures, shown)
        goal, pose = make_goal(context, shown, goal_joints, postures, arm, believed, others)
        start = find_start(context, postures, arm, pose, goal_joints)
        notes = check_postures(context, postures, goal_joints, start, bool(shown.joints))
        servo = make_servo(context, believed, goal)
        rig = context.settings.rig(
            {context.control.name: believed, **others}, context.scheme, servo.goal
        )
        plant = make_plant(context, arm, start)
    except (ServoError, ViewError) as error:
        raise ExperimentError(str(error)) from error
    return Assembly(
        plant, context.settings, servo, rig, context.eyes, goal, pose, context.target,
        context.places, postures, notes,
    )  # fmt: skip


def check(experiment: Experiment) -> None:
    """ExperimentError for what is wrong before a plant is made: names, files, poses."""
    context = read_context(experiment)
    try:
        check_scheme(context)
        if not isinstance(context.experiment.start, Sampler | CameraPose):
            given_start(context)
        shown = read_goal(context)
        if shown.named is None:
            from .goal_teaching import check_view

            check_view(context, shown.pose)
    except (ServoError, ViewError) as error:
        raise ExperimentError(str(error)) from error


# -- goal ------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ShownGoal:
    """Where a goal is shown.

    pose: world_T_camera (4, 4) of the true control camera. joints: of the arm there, by name;
    empty: not given. named: the goal of a file; None: it is taught.
    """

    pose: np.ndarray
    joints: Mapping[str, float]
    named: Goal | None = None


def read_goal(context: SetupContext) -> ShownGoal:
    """Where the experiment's goal is shown; ExperimentError where it does not say so."""
    given, arm = context.experiment.goal, context.arm
    if isinstance(given, CameraPose):
        return ShownGoal(transform(given.pose[:3], given.pose[3:]), {})
    if not isinstance(given, str):
        joints = _given_goal_joints(context)
        named = dict(zip(arm.names, joints.tolist(), strict=True))
        return ShownGoal(arm.pose(joints), {} if context.flies else named)
    goal = here = named_goal(context.experiment, context.settings)
    if not context.flies or goal.world_T_camera is None:
        here = goal.for_arm(arm)
    if here.world_T_camera is None:
        raise ExperimentError(f"the goal {goal.name} says neither joints nor camera_pose")
    if context.flies:
        goal = here = replace(here, joints={})
    return ShownGoal(np.array(here.world_T_camera), here.joints, goal)


def _given_goal_joints(context: SetupContext) -> np.ndarray:
    """The joints (n,) that the goal is taught at, where it names joints."""
    try:
        joints = start_joints(context.experiment.goal, context.arm, context.settings.package)
    except ConfigurationError as error:  # it speaks of a start, which it mostly is
        raise ExperimentError(str(error).replace("parameter ~start", "goal", 1)) from error
    check_inside(joints, context.arm, "goal")
    return joints


def make_arms(context: SetupContext, pose: np.ndarray) -> tuple[Arm | FreeBody, Arm | FreeBody]:
    """The true arm and the believed one; of a camera that flies, about the goal's pose (4, 4)."""
    believed = context.control.spec.believed
    if not context.flies:
        return context.arm, context.robot.believed_arm(
            believed.xyz, believed.rpy, context.control.name
        )
    body = FreeBody(pose)
    if not believed.moved:
        return body, body
    return body, FreeBody(pose, transform(believed.xyz, believed.rpy))


def believed_others(
    context: SetupContext, pose: np.ndarray, control: Arm | FreeBody
) -> dict[str, FreeBody | MovedBy]:
    """What is believed to move the other cameras that the scheme reads, by their names.

    Args:
        pose: world_T_camera (4, 4) of the true control camera at the goal.
        control: what is believed to move the control camera.
    """
    others: dict[str, FreeBody | MovedBy] = {}
    for name in list(context.needs)[1:]:
        if not context.flies:
            others[name] = context.robot.arm_of(name, control, believed=True)
            continue
        place, belief = context.places[name], context.eyes[name].spec.believed
        seat = place.pose @ transform(belief.xyz, belief.rpy)
        others[name] = StandingCamera(seat) if place.stands else FreeBody(pose, seat)
    return others


def make_postures(context: SetupContext) -> Postures:
    """Postures of the arm with the control camera before the target."""
    from ..asked.worlds import world_path
    from .postures import Postures

    experiment, control = context.experiment, context.control
    solid = experiment.plant == "bullet"
    return Postures.of(
        context.robot, control, context.target_spec(control.name), solid and experiment.pictures,
        solid, world_path(experiment, context.robot.packages),
    )  # fmt: skip


def find_goal_joints(
    context: SetupContext, postures: Postures | None, shown: ShownGoal
) -> np.ndarray | None:
    """Joints (n,) of the arm at the goal; None of a camera that flies, or where the arm cannot be
    there, which is an outcome."""
    if shown.joints and postures is not None:
        return np.array([shown.joints[name] for name in context.arm.names])
    return find_joints(postures, shown.pose)


def find_joints(postures: Postures | None, pose: np.ndarray) -> np.ndarray | None:
    """Joints (n,) with the camera at world_T_camera (4, 4); None: there are none."""
    if postures is None:
        return None
    try:
        return postures.at(pose)
    except UnreachableError:
        return None


def make_goal(
    context: SetupContext, shown: ShownGoal, joints: np.ndarray | None, postures: Postures | None,
    arm: Arm | FreeBody, believed: Arm | FreeBody, others: Mapping[str, MovedBy | FreeBody],
) -> tuple[Goal, np.ndarray]:
    """The goal of the loop, computed from a file or taught, and its world_T_camera (4, 4).

    Args:
        joints: (n,) of the arm there; None: not known. postures: of the arm, if there is one.
        arm, believed: true and believed. others: what is believed to move the other cameras.
    """
    control, named = context.control.name, shown.named
    goal = None if named is None else compute_goal(context, named, {control: believed, **others})
    if goal is not None:
        if others:
            from .goal_teaching import check_view

            check_view(context, goal.world_T_camera)
        return with_believed_depths(context, goal), goal.world_T_camera
    from .goal_teaching import show_goal

    goal = show_goal(context, shown.pose, named.name if named is not None else "goal", joints,
                     postures, arm, believed, others)  # fmt: skip
    return with_believed_depths(context, goal), shown.pose


def compute_goal(
    context: SetupContext, named: Goal, arms: Mapping[str, FreeBody | MovedBy]
) -> Goal | None:
    """A named goal as the believed cameras see it; None where it lacks what the scheme needs, or
    was shown another target: the demo's plates in place of a solid, or the control camera's in
    place of a camera's own."""
    goal = named.for_cameras(arms)
    if any(context.has_own_target(n) and n not in named.cameras for n in context.needs):
        return None  # what it was shown is not what these look at
    if goal.target is not None and context.target.shape.is_solid:
        return None
    try:
        context.scheme.check(goal)
    except ConfigurationError:
        return None
    return goal


def with_believed_depths(context: SetupContext, goal: Goal) -> Goal:
    """The goal with its depths as they are believed."""
    deeper = {
        name: _with_depth_times(one, context.eyes[name].spec.believed.depth)
        for name, one in goal.cameras.items() if name in context.eyes
    }  # fmt: skip
    own = deeper.pop(context.control.name)
    return replace(own, others=deeper) if deeper else own


def _with_depth_times(goal: Goal, factor: float) -> Goal:
    """The goal with its depth, and its plane's, multiplied: what a wrong belief makes of it."""
    if factor == 1.0:
        return goal
    depth = None if goal.depth is None else goal.depth * factor
    plane = None if goal.plane is None else Plane(*(part / factor for part in goal.plane))
    return replace(goal, depth=depth, plane=plane)


# -- start, loop and plant ---------------------------------------------------------------------


def find_start(
    context: SetupContext, postures: Postures | None, arm: Arm | FreeBody, goal_pose: np.ndarray,
    goal_joints: np.ndarray | None,
) -> np.ndarray:
    """Joints (n,) at the start; `goal_joints`: those at the goal, None: they are not known."""
    start = context.experiment.start
    if isinstance(start, Sampler):
        from .sampling import draw_start

        near = find_joints(postures, goal_pose)
        near = np.zeros(len(arm.names)) if near is None else near
        return draw_start(
            start, arm, goal_pose, near, context.target, context.control.true,
            context.experiment.seed,
            [(context.places[n], context.eyes[n].true, context.targets[n])
             for n in list(context.needs)[1:]],
            None if postures is None else postures.touched,
        )  # fmt: skip
    if isinstance(start, CameraPose):
        pose = transform(start.pose[:3], start.pose[3:])
        return arm.coordinates(pose) if postures is None else postures.start(pose, goal_joints)
    joints = given_start(context)
    return arm.coordinates(context.arm.pose(joints)) if postures is None else joints


def given_start(context: SetupContext) -> np.ndarray:
    """Joints (n,) of a start that is given by name or as joints."""
    joints = start_joints(context.experiment.start, context.arm, context.settings.package)
    if joints is None:
        raise ExperimentError("start is 'none', but a plant has to begin somewhere")
    check_inside(joints, context.arm, "start")
    return joints


def check_postures(
    context: SetupContext, postures: Postures | None, goal: np.ndarray | None, start: np.ndarray,
    given: bool,
) -> tuple[str, ...]:
    """What speaks against the joints (n,) at the goal and at the start; it is logged once.

    goal: None: not known. given: whether the goal is given as joints.
    """
    if postures is None or goal is None:
        return ()
    notes = postures.faults(goal, "goal", given)
    if not isinstance(context.experiment.start, Sampler):
        by_joints = not isinstance(context.experiment.start, CameraPose)
        notes += postures.faults(start, "start", by_joints)
    for note in notes:
        log_once(note)
    return tuple(notes)


def make_servo(context: SetupContext, believed: Arm | FreeBody, goal: Goal) -> Servo:
    """The loop."""
    resolver = None
    if context.experiment.plant == "ideal":
        from ..plants.ideal import ExactResolver

        resolver = ExactResolver(believed, context.control.rate, context.experiment.ideal.speed)
    return context.settings.build(believed, goal, scheme=context.scheme, resolver=resolver)


def make_plant(context: SetupContext, arm: Arm | FreeBody, start: np.ndarray) -> Plant:
    """The plant at joints (n,)."""
    experiment = context.experiment
    if experiment.plant == "bullet":
        from .bullet_setup import make_bullet_arm

        return make_bullet_arm(context, start)
    if experiment.plant == "ideal":
        from ..plants.ideal import IdealCamera

        believed = experiment.believed
        body = FreeBody(arm.origin, transform(believed.xyz, believed.rpy))
        return IdealCamera(arm, body, start, make_sight(context, context.control), experiment.seed)
    kind = FreeCamera if experiment.plant == "free" else KinematicChain
    sight, *others = (make_sight(context, eye) for eye in context.eyes.values())
    return kind(arm, start, sight, lag=experiment.lag, seed=experiment.seed, others=others)
