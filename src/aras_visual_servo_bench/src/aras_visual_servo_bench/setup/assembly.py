"""Build a run from an experiment: robot, cameras, loop, goal, start and plant.

The functions below `assemble` are in the order in which it calls them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_controller.errors import ServoError, UnreachableError
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.goals.starts import find_start_joints
from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.kinematics.command_limits import check_within_limits
from aras_visual_servo_controller.loop.servo import Servo
from aras_visual_servo_controller.observation.camera_rig import (
    CameraKinematics,
    CameraRig,
    FixedCameraKinematics,
)
from aras_visual_servo_controller.observation.feature_observer import observe
from aras_visual_servo_controller.observation.frame import Frame
from aras_visual_servo_controller.observation.observation import Need, Observation
from aras_visual_servo_controller.settings import ControllerSettings

from ..errors import ExperimentError, OutOfViewError, log_once
from ..experiment.cameras import CameraSetup
from ..experiment.experiment import CameraPoseSpec, Experiment, RandomStart
from ..plants.base import CameraPlacement, Plant
from ..plants.free_camera_kinematics import FreeCameraKinematics
from ..plants.kinematic import FreeCamera, KinematicArm
from ..targets.geometry import PlacedTarget
from .imaging_setup import make_imaging_settings
from .robot_camera_reader import SchemeWrapper, check_scheme, read_context
from .run_goal import GoalLocation, make_goal, read_goal
from .run_setup import GoalImages, RunSetup

if TYPE_CHECKING:
    from .posture_search import PostureSearch


@dataclass
class Assembly:
    """Objects that make up a run; `assemble` makes them.

    Attributes:
        plant: arm or free camera, at its start.
        settings: settings of the control loop.
        servo: control loop.
        rig: computes the observations of the cameras.
        cameras: cameras by name, the control camera first.
        goal: goal of the control loop.
        goal_pose: true world_T_camera (4, 4) of the control camera at the goal.
        target: target of the control camera, with its pose in the world.
        placements: poses of the other cameras relative to the control camera, by name.
        postures: object that finds joint positions of the arm; None for a free camera.
        notes: warnings about occlusions and collisions of the arm at start and goal.
    """

    plant: Plant
    settings: ControllerSettings
    servo: Servo
    rig: CameraRig
    cameras: Mapping[str, CameraSetup]
    goal: Goal
    goal_pose: np.ndarray
    target: PlacedTarget
    placements: Mapping[str, CameraPlacement]
    postures: PostureSearch | None = None
    notes: tuple[str, ...] = ()

    @property
    def calibrated_camera(self) -> CameraModel:
        """Intrinsics that the controller uses for the control camera."""
        return self.cameras[self.rig.control.name].calibrated_camera

    @property
    def needs(self) -> frozenset[Need]:
        """Data that the loop needs from an image of the control camera."""
        return self.rig.control.needs

    def observe(self, frame: Frame, joints: Any, commands: tuple = ()) -> Observation:
        """Compute the observation of a frame as the controller does.

        On the plant 'ideal', the observation contains the plane of the target, computed from the
        exact camera pose.
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
    goal_images: GoalImages | None = None,
) -> Assembly:
    """Make the plant, control loop, cameras and goal of an experiment, with the plant at its start.

    Args:
        experiment: settings of the run.
        wrap_scheme: function that receives the scheme of the experiment and returns the scheme to
            run, for example one that records its output; None: the scheme is used unchanged.
        has_unread_cameras: whether to make the cameras that the scheme does not read, too.
        has_depth: whether every camera delivers depth images, even if the scheme needs none.
        goal_images: images of goals that runs share, so that each goal is rendered once; None: the
            goal is rendered if its features need images.

    Returns:
        The objects of the run, for `Loop`.

    Raises:
        ExperimentError: the experiment cannot be run; the message names the wrong key and the
            remedy.
    """
    context = read_context(experiment, wrap_scheme, has_unread_cameras, has_depth, goal_images)
    try:
        check_scheme(context)
        location = read_goal(context)
        arm, calibrated = make_arms(context, location.pose)
        others = make_calibrated_kinematics(context, location.pose, calibrated)
        postures = None if context.has_free_camera else make_postures(context)
        goal_joints = find_goal_joints(context, postures, location)
        goal, pose = make_goal(context, location, goal_joints, postures, arm, calibrated, others)
        start = find_start(context, postures, arm, pose, goal_joints)
        notes = check_postures(context, postures, goal_joints, start, bool(location.joints))
        servo = make_servo(context, calibrated, goal)
        rig = context.settings.make_camera_rig(
            {context.control_camera.name: calibrated, **others}, context.scheme, servo.goal
        )
        plant = make_plant(context, arm, start)
    except (ServoError, OutOfViewError) as error:
        raise ExperimentError(str(error)) from error
    return Assembly(
        plant, context.settings, servo, rig, context.cameras, goal, pose, context.target,
        context.placements, postures, notes,
    )  # fmt: skip


def check(experiment: Experiment) -> None:
    """Check the names, files and poses of an experiment without making its plant.

    Raises:
        ExperimentError: the experiment cannot be run.
    """
    context = read_context(experiment)
    try:
        check_scheme(context)
        if not isinstance(context.experiment.start, RandomStart | CameraPoseSpec):
            read_start_joints(context)
        location = read_goal(context)
        if location.loaded_goal is None:
            from .goal_teaching import check_view

            check_view(context, location.pose)
    except (ServoError, OutOfViewError) as error:
        raise ExperimentError(str(error)) from error


def make_arms(
    context: RunSetup, pose: np.ndarray
) -> tuple[Arm | FreeCameraKinematics, Arm | FreeCameraKinematics]:
    """Return the arm with the true camera calibration, and with the one that the controller uses.

    pose: world_T_camera (4, 4) at the goal, from which the coordinates of a free camera are
        measured.
    """
    offset = context.control_camera.spec.calibration_offset
    if not context.has_free_camera:
        return context.arm, context.robot.make_calibrated_arm(
            offset.xyz, offset.rpy, context.control_camera.name
        )
    moved = matrix_from_xyz_rpy(offset.xyz, offset.rpy) if offset.is_moved else None
    return FreeCameraKinematics(pose), FreeCameraKinematics(pose, moved)


def make_calibrated_kinematics(
    context: RunSetup, pose: np.ndarray, control: Arm | FreeCameraKinematics
) -> dict[str, FreeCameraKinematics | CameraKinematics]:
    """Return the kinematics, as the controller knows them, of all cameras but the control camera.

    Args:
        pose: true world_T_camera (4, 4) of the control camera at the goal.
        control: kinematics of the control camera, as the controller knows them.
    """
    others: dict[str, FreeCameraKinematics | CameraKinematics] = {}
    for name in list(context.needs)[1:]:
        if not context.has_free_camera:
            others[name] = context.robot.make_camera_kinematics(name, control, is_calibrated=True)
            continue
        placement, offset = context.placements[name], context.cameras[name].spec.calibration_offset
        calibrated = placement.pose @ matrix_from_xyz_rpy(offset.xyz, offset.rpy)
        others[name] = (
            FixedCameraKinematics(calibrated)
            if placement.is_fixed
            else FreeCameraKinematics(pose, calibrated)
        )
    return others


def make_postures(context: RunSetup) -> PostureSearch:
    """Make the object that finds postures of the arm for a given pose of the control camera."""
    from ..experiment.worlds import find_world_path
    from .posture_search import PostureSearch

    experiment, control = context.experiment, context.control_camera
    solid = experiment.plant == "bullet"
    return PostureSearch.for_robot(
        context.robot, control, context.find_target_spec(control.name), solid
        and experiment.has_images,
        solid, find_world_path(experiment, context.robot.packages),
    )  # fmt: skip


def find_goal_joints(
    context: RunSetup, postures: PostureSearch | None, location: GoalLocation
) -> np.ndarray | None:
    """Return the joint positions (n,) at the goal.

    Return None for a free camera, and if the arm cannot reach the goal; in the second case, the run
    reports an unreachable goal as its outcome.
    """
    if location.joints and postures is not None:
        return np.array([location.joints[name] for name in context.arm.names])
    return find_joints(postures, location.pose)


def find_joints(postures: PostureSearch | None, pose: np.ndarray) -> np.ndarray | None:
    """Return joint positions (n,) that put the camera at a pose; None if there are none.

    pose: world_T_camera (4, 4) of the control camera.
    """
    if postures is None:
        return None
    try:
        return postures.find_joints(pose)
    except UnreachableError:
        return None


def find_start(
    context: RunSetup,
    postures: PostureSearch | None,
    arm: Arm | FreeCameraKinematics,
    goal_pose: np.ndarray,
    goal_joints: np.ndarray | None,
) -> np.ndarray:
    """Return the joint positions (n,) at the start.

    goal_joints: joint positions (n,) at the goal; None: not known.
    """
    start = context.experiment.start
    if isinstance(start, RandomStart):
        from .start_sampling import draw_start

        near = find_joints(postures, goal_pose)
        near = np.zeros(len(arm.names)) if near is None else near
        return draw_start(
            start, arm, goal_pose, near, context.target, context.control_camera.true_camera,
            context.experiment.seed,
            [(context.placements[n], context.cameras[n].true_camera, context.targets[n])
             for n in list(context.needs)[1:]],
            None if postures is None else postures.find_collision,
        )  # fmt: skip
    if isinstance(start, CameraPoseSpec):
        pose = matrix_from_xyz_rpy(start.pose[:3], start.pose[3:])
        return (
            arm.coordinates(pose)
            if postures is None
            else postures.find_start_joints(pose, goal_joints)
        )
    joints = read_start_joints(context)
    return arm.coordinates(context.arm.pose(joints)) if postures is None else joints


def read_start_joints(context: RunSetup) -> np.ndarray:
    """Return the joint positions (n,) of a start that is given by a name or by joint positions."""
    joints = find_start_joints(context.experiment.start, context.arm, context.settings.package)
    if joints is None:
        raise ExperimentError("start is 'none', but a plant needs a start: give a pose or joints")
    check_within_limits(joints, context.arm, "start")
    return joints


def check_postures(
    context: RunSetup, postures: PostureSearch | None, goal: np.ndarray | None, start: np.ndarray,
    is_given: bool,
) -> tuple[str, ...]:
    """Log warnings about occlusions and collisions of the arm at goal and start, and return them.

    Args:
        goal: joint positions (n,) at the goal; None: not known.
        start: joint positions (n,) at the start.
        is_given: whether the experiment gives the joints at the goal.
    """
    if postures is None or goal is None:
        return ()
    notes = postures.list_faults(goal, "goal", is_given)
    if not isinstance(context.experiment.start, RandomStart):
        by_joints = not isinstance(context.experiment.start, CameraPoseSpec)
        notes += postures.list_faults(start, "start", by_joints)
    for note in notes:
        log_once(note)
    return tuple(notes)


def make_servo(context: RunSetup, calibrated_arm: Arm | FreeCameraKinematics, goal: Goal) -> Servo:
    """Make the control loop; on the plant 'ideal', it executes the scheme's twist exactly."""
    differential_ik = None
    if context.experiment.plant == "ideal":
        from ..plants.ideal_camera import IdealCameraIK

        differential_ik = IdealCameraIK(
            calibrated_arm, context.control_camera.rate, context.experiment.ideal.speed
        )
    return context.settings.make_servo(
        calibrated_arm, goal, scheme=context.scheme, differential_ik=differential_ik
    )


def make_plant(context: RunSetup, arm: Arm | FreeCameraKinematics, start: np.ndarray) -> Plant:
    """Make the plant, with the arm at the joint positions `start` (n,)."""
    experiment = context.experiment
    if experiment.plant == "bullet":
        from .dynamic_arm_setup import make_dynamic_arm

        return make_dynamic_arm(context, start)
    if experiment.plant == "ideal":
        from ..plants.ideal_camera import IdealCamera

        offset = experiment.calibration_offset
        body = FreeCameraKinematics(arm.origin, matrix_from_xyz_rpy(offset.xyz, offset.rpy))
        return IdealCamera(
            arm,
            body,
            start,
            make_imaging_settings(context, context.control_camera),
            experiment.seed,
        )
    kind = FreeCamera if experiment.plant == "free" else KinematicArm
    imaging, *others = (make_imaging_settings(context, c) for c in context.cameras.values())
    return kind(arm, start, imaging, lag=experiment.lag, seed=experiment.seed, other_imaging=others)
