"""Build a run from an experiment: robot, cameras, loop, goal, start and plant.

The functions stand in the order in which `assemble` calls them; `read_context` comes first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.undistortion import CameraModel
from aras_visual_servo_controller.errors import ConfigurationError, ServoError, UnreachableError
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.goals.starts import find_start_joints
from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.kinematics.limits import check_within_limits
from aras_visual_servo_controller.loop.servo import Servo
from aras_visual_servo_controller.observation.camera_rig import (
    CameraKinematics,
    CameraRig,
    FixedCameraKinematics,
)
from aras_visual_servo_controller.observation.feature_observer import observe
from aras_visual_servo_controller.observation.frame import Frame
from aras_visual_servo_controller.observation.observation import Need, Observation
from aras_visual_servo_controller.settings import Settings

from ..errors import ExperimentError, ViewError, log_once
from ..experiment.cameras import CameraSetup
from ..experiment.experiment import CameraPose, Experiment, Sampler
from ..experiment.loop_settings import load_named_goal
from ..plants.base import CameraPlacement, Plant
from ..plants.free_body import FreeBody
from ..plants.kinematic import FreeCamera, KinematicArm
from ..targets.geometry import PlacedTarget
from .imaging_setup import make_imaging_settings
from .read_context import SchemeWrapper, check_scheme, read_context
from .setup_context import SetupContext

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
    rig: CameraRig
    cameras: Mapping[str, CameraSetup]
    goal: Goal
    goal_pose: np.ndarray
    target: PlacedTarget
    placements: Mapping[str, CameraPlacement]
    postures: Postures | None = None
    notes: tuple[str, ...] = ()

    @property
    def calibrated_camera(self) -> CameraModel:
        """The control camera as the controller believes it."""
        return self.cameras[self.rig.control.name].calibrated_camera

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
            plane = self.servo.goal.compute_plane(self.servo.arm.pose(joints.positions))
        return observe(frame, joints, self.rig.observers[frame.name],
                       self.cameras[frame.name].calibrated_camera, commands, plane)  # fmt: skip


def assemble(
    experiment: Experiment,
    wrap_scheme: SchemeWrapper | None = None,
    has_unread_cameras: bool = True,
    has_depth: bool = False,
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
    context = read_context(experiment, wrap_scheme, has_unread_cameras, has_depth)
    try:
        check_scheme(context)
        shown = read_goal(context)
        arm, believed = make_arms(context, shown.pose)
        others = make_calibrated_kinematics(context, shown.pose, believed)
        postures = None if context.has_free_camera else make_postures(context)
        goal_joints = find_goal_joints(context, postures, shown)
        goal, pose = make_goal(context, shown, goal_joints, postures, arm, believed, others)
        start = find_start(context, postures, arm, pose, goal_joints)
        notes = check_postures(context, postures, goal_joints, start, bool(shown.joints))
        servo = make_servo(context, believed, goal)
        rig = context.settings.make_camera_rig(
            {context.control_camera.name: believed, **others}, context.scheme, servo.goal
        )
        plant = make_plant(context, arm, start)
    except (ServoError, ViewError) as error:
        raise ExperimentError(str(error)) from error
    return Assembly(
        plant, context.settings, servo, rig, context.cameras, goal, pose, context.target,
        context.placements, postures, notes,
    )  # fmt: skip


def check(experiment: Experiment) -> None:
    """ExperimentError for what is wrong before a plant is made: names, files, poses."""
    context = read_context(experiment)
    try:
        check_scheme(context)
        if not isinstance(context.experiment.start, Sampler | CameraPose):
            read_start_joints(context)
        shown = read_goal(context)
        if shown.loaded_goal is None:
            from .goal_teaching import check_view

            check_view(context, shown.pose)
    except (ServoError, ViewError) as error:
        raise ExperimentError(str(error)) from error


# -- goal ------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class GoalLocation:
    """Where a goal is shown.

    pose: world_T_camera (4, 4) of the true control camera. joints: of the arm there, by name;
    empty: not given. named: the goal of a file; None: it is taught.
    """

    pose: np.ndarray
    joints: Mapping[str, float]
    loaded_goal: Goal | None = None


def read_goal(context: SetupContext) -> GoalLocation:
    """Where the experiment's goal is shown; ExperimentError where it does not say so."""
    given, arm = context.experiment.goal, context.arm
    if isinstance(given, CameraPose):
        return GoalLocation(matrix_from_xyz_rpy(given.pose[:3], given.pose[3:]), {})
    if not isinstance(given, str):
        joints = _read_goal_joints(context)
        named = dict(zip(arm.names, joints.tolist(), strict=True))
        return GoalLocation(arm.pose(joints), {} if context.has_free_camera else named)
    goal = here = load_named_goal(context.experiment, context.settings)
    if not context.has_free_camera or goal.world_T_camera is None:
        here = goal.for_arm(arm)
    if here.world_T_camera is None:
        raise ExperimentError(f"the goal {goal.name} says neither joints nor camera_pose")
    if context.has_free_camera:
        goal = here = replace(here, joints={})
    return GoalLocation(np.array(here.world_T_camera), here.joints, goal)


def _read_goal_joints(context: SetupContext) -> np.ndarray:
    """The joints (n,) that the goal is taught at, where it names joints."""
    try:
        joints = find_start_joints(context.experiment.goal, context.arm, context.settings.package)
    except ConfigurationError as error:  # it speaks of a start, which it mostly is
        raise ExperimentError(str(error).replace("parameter ~start", "goal", 1)) from error
    check_within_limits(joints, context.arm, "goal")
    return joints


def make_arms(context: SetupContext, pose: np.ndarray) -> tuple[Arm | FreeBody, Arm | FreeBody]:
    """The true arm and the believed one; of a camera that flies, about the goal's pose (4, 4)."""
    believed = context.control_camera.spec.calibration_offset
    if not context.has_free_camera:
        return context.arm, context.robot.make_calibrated_arm(
            believed.xyz, believed.rpy, context.control_camera.name
        )
    body = FreeBody(pose)
    if not believed.is_moved:
        return body, body
    return body, FreeBody(pose, matrix_from_xyz_rpy(believed.xyz, believed.rpy))


def make_calibrated_kinematics(
    context: SetupContext, pose: np.ndarray, control: Arm | FreeBody
) -> dict[str, FreeBody | CameraKinematics]:
    """What is believed to move the other cameras that the scheme reads, by their names.

    Args:
        pose: world_T_camera (4, 4) of the true control camera at the goal.
        control: what is believed to move the control camera.
    """
    others: dict[str, FreeBody | CameraKinematics] = {}
    for name in list(context.needs)[1:]:
        if not context.has_free_camera:
            others[name] = context.robot.make_camera_kinematics(name, control, is_calibrated=True)
            continue
        place, belief = context.placements[name], context.cameras[name].spec.calibration_offset
        seat = place.pose @ matrix_from_xyz_rpy(belief.xyz, belief.rpy)
        others[name] = FixedCameraKinematics(seat) if place.is_fixed else FreeBody(pose, seat)
    return others


def make_postures(context: SetupContext) -> Postures:
    """Postures of the arm with the control camera before the target."""
    from ..experiment.worlds import find_world_path
    from .postures import Postures

    experiment, control = context.experiment, context.control_camera
    solid = experiment.plant == "bullet"
    return Postures.for_robot(
        context.robot, control, context.find_target_spec(control.name), solid
        and experiment.has_images,
        solid, find_world_path(experiment, context.robot.packages),
    )  # fmt: skip


def find_goal_joints(
    context: SetupContext, postures: Postures | None, location: GoalLocation
) -> np.ndarray | None:
    """Joints (n,) of the arm at the goal; None of a camera that flies, or where the arm cannot be
    there, which is an outcome."""
    if location.joints and postures is not None:
        return np.array([location.joints[name] for name in context.arm.names])
    return find_joints(postures, location.pose)


def find_joints(postures: Postures | None, pose: np.ndarray) -> np.ndarray | None:
    """Joints (n,) with the camera at world_T_camera (4, 4); None: there are none."""
    if postures is None:
        return None
    try:
        return postures.find_joints(pose)
    except UnreachableError:
        return None


def make_goal(
    context: SetupContext,
    location: GoalLocation,
    joints: np.ndarray | None,
    postures: Postures | None,
    arm: Arm | FreeBody,
    calibrated_arm: Arm | FreeBody,
    calibrated_others: Mapping[str, CameraKinematics | FreeBody],
) -> tuple[Goal, np.ndarray]:
    """The goal of the loop, computed from a file or taught, and its world_T_camera (4, 4).

    Args:
        joints: (n,) of the arm there; None: not known. postures: of the arm, if there is one.
        arm, believed: true and believed. others: what is believed to move the other cameras.
    """
    control, named = context.control_camera.name, location.loaded_goal
    goal = (
        None
        if named is None
        else compute_goal(context, named, {control: calibrated_arm, **calibrated_others})
    )
    if goal is not None:
        if calibrated_others:
            from .goal_teaching import check_view

            check_view(context, goal.world_T_camera)
        return with_calibrated_depths(context, goal), goal.world_T_camera
    from .goal_teaching import show_goal

    goal = show_goal(context, location.pose, named.name if named is not None else "goal", joints,
                     postures, arm, calibrated_arm, calibrated_others)  # fmt: skip
    return with_calibrated_depths(context, goal), location.pose


def compute_goal(
    context: SetupContext, loaded_goal: Goal, arms: Mapping[str, FreeBody | CameraKinematics]
) -> Goal | None:
    """A named goal as the believed cameras see it; None where it lacks what the scheme needs, or
    was shown another target: the demo's plates in place of a solid, or the control camera's in
    place of a camera's own."""
    goal = loaded_goal.for_cameras(arms)
    if any(context.has_own_target(n) and n not in loaded_goal.cameras for n in context.needs):
        return None  # what it was shown is not what these look at
    if goal.target is not None and context.target.shape.is_solid:
        return None
    try:
        context.scheme.check(goal)
    except ConfigurationError:
        return None
    return goal


def with_calibrated_depths(context: SetupContext, goal: Goal) -> Goal:
    """The goal with its depths as they are believed."""
    deeper = {
        name: _scale_depth(one, context.cameras[name].spec.calibration_offset.depth)
        for name, one in goal.cameras.items() if name in context.cameras
    }  # fmt: skip
    own = deeper.pop(context.control_camera.name)
    return replace(own, other_cameras=deeper) if deeper else own


def _scale_depth(goal: Goal, factor: float) -> Goal:
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
            start, arm, goal_pose, near, context.target, context.control_camera.true_camera,
            context.experiment.seed,
            [(context.placements[n], context.cameras[n].true_camera, context.targets[n])
             for n in list(context.needs)[1:]],
            None if postures is None else postures.find_collision,
        )  # fmt: skip
    if isinstance(start, CameraPose):
        pose = matrix_from_xyz_rpy(start.pose[:3], start.pose[3:])
        return (
            arm.coordinates(pose)
            if postures is None
            else postures.find_start_joints(pose, goal_joints)
        )
    joints = read_start_joints(context)
    return arm.coordinates(context.arm.pose(joints)) if postures is None else joints


def read_start_joints(context: SetupContext) -> np.ndarray:
    """Joints (n,) of a start that is given by name or as joints."""
    joints = find_start_joints(context.experiment.start, context.arm, context.settings.package)
    if joints is None:
        raise ExperimentError("start is 'none', but a plant has to begin somewhere")
    check_within_limits(joints, context.arm, "start")
    return joints


def check_postures(
    context: SetupContext, postures: Postures | None, goal: np.ndarray | None, start: np.ndarray,
    is_given: bool,
) -> tuple[str, ...]:
    """What speaks against the joints (n,) at the goal and at the start; it is logged once.

    goal: None: not known. given: whether the goal is given as joints.
    """
    if postures is None or goal is None:
        return ()
    notes = postures.list_faults(goal, "goal", is_given)
    if not isinstance(context.experiment.start, Sampler):
        by_joints = not isinstance(context.experiment.start, CameraPose)
        notes += postures.list_faults(start, "start", by_joints)
    for note in notes:
        log_once(note)
    return tuple(notes)


def make_servo(context: SetupContext, calibrated_arm: Arm | FreeBody, goal: Goal) -> Servo:
    """The loop."""
    resolver = None
    if context.experiment.plant == "ideal":
        from ..plants.ideal import ExactIK

        resolver = ExactIK(
            calibrated_arm, context.control_camera.rate, context.experiment.ideal.speed
        )
    return context.settings.make_servo(
        calibrated_arm, goal, scheme=context.scheme, differential_ik=resolver
    )


def make_plant(context: SetupContext, arm: Arm | FreeBody, start: np.ndarray) -> Plant:
    """The plant at joints (n,)."""
    experiment = context.experiment
    if experiment.plant == "bullet":
        from .dynamic_arm_setup import make_dynamic_arm

        return make_dynamic_arm(context, start)
    if experiment.plant == "ideal":
        from ..plants.ideal import IdealCamera

        believed = experiment.calibration_offset
        body = FreeBody(arm.origin, matrix_from_xyz_rpy(believed.xyz, believed.rpy))
        return IdealCamera(
            arm,
            body,
            start,
            make_imaging_settings(context, context.control_camera),
            experiment.seed,
        )
    kind = FreeCamera if experiment.plant == "free" else KinematicArm
    sight, *others = (make_imaging_settings(context, eye) for eye in context.cameras.values())
    return kind(arm, start, sight, lag=experiment.lag, seed=experiment.seed, other_imaging=others)
