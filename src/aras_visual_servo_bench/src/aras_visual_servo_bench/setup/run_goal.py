"""Goal of a run: its pose, and its data from a file or from the view at this pose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.goals.starts import find_start_joints
from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.kinematics.command_limits import check_within_limits
from aras_visual_servo_controller.observation.camera_rig import CameraKinematics

from ..errors import ExperimentError
from ..experiment.experiment import CameraPoseSpec
from ..experiment.loop_settings import load_named_goal
from ..plants.free_camera_kinematics import FreeCameraKinematics
from .run_setup import RunSetup

if TYPE_CHECKING:
    from .posture_search import PostureSearch


@dataclass(frozen=True, eq=False)
class GoalLocation:
    """Camera pose and joint positions at the goal.

    pose: true world_T_camera (4, 4) of the control camera.
    joints: position of each joint at the goal, by name; empty if the experiment gives none.
    loaded_goal: goal that was read from a file; None: no file is given, so the goal is taught.
    """

    pose: np.ndarray
    joints: Mapping[str, float]
    loaded_goal: Goal | None = None


def read_goal(context: RunSetup) -> GoalLocation:
    """Return the camera pose and the joint positions at the goal of an experiment.

    Raises:
        ExperimentError: the goal file contains neither joint positions nor a camera pose.
    """
    setting, arm = context.experiment.goal, context.arm
    if isinstance(setting, CameraPoseSpec):
        return GoalLocation(matrix_from_xyz_rpy(setting.pose[:3], setting.pose[3:]), {})
    if not isinstance(setting, str):
        joints = _read_goal_joints(context)
        positions = dict(zip(arm.names, joints.tolist(), strict=True))
        return GoalLocation(arm.pose(joints), {} if context.has_free_camera else positions)
    goal = completed = load_named_goal(context.experiment, context.settings)
    if not context.has_free_camera or goal.world_T_camera is None:
        completed = goal.for_arm(arm)
    if completed.world_T_camera is None:
        raise ExperimentError(
            f"the goal {goal.name} has neither joints nor camera_pose: add one of them to its file"
        )
    if context.has_free_camera:
        goal = completed = replace(completed, joints={})
    return GoalLocation(np.array(completed.world_T_camera), completed.joints, goal)


def _read_goal_joints(context: RunSetup) -> np.ndarray:
    """Return the joint positions (n,) of a goal that the experiment gives as joint positions."""
    try:
        joints = find_start_joints(context.experiment.goal, context.arm, context.settings.package)
    # The error message names the parameter `~start`, but the wrong setting is `goal`.
    except ConfigurationError as error:
        raise ExperimentError(str(error).replace("parameter ~start", "goal", 1)) from error
    check_within_limits(joints, context.arm, "goal")
    return joints


def make_goal(
    context: RunSetup,
    location: GoalLocation,
    joints: np.ndarray | None,
    postures: PostureSearch | None,
    arm: Arm | FreeCameraKinematics,
    calibrated_arm: Arm | FreeCameraKinematics,
    calibrated_others: Mapping[str, CameraKinematics | FreeCameraKinematics],
) -> tuple[Goal, np.ndarray]:
    """Return the goal of the loop, and world_T_camera (4, 4) at the goal.

    The goal is computed from a goal file if possible; otherwise it is taught.

    Args:
        location: camera pose and joint positions at the goal.
        joints: joint positions (n,) at the goal; None: not known.
        postures: search for postures of the arm; None for a free camera.
        arm: true kinematics of the control camera.
        calibrated_arm: kinematics of the control camera, as the controller knows them.
        calibrated_others: kinematics of the other cameras, as the controller knows them, by name.
    """
    control, loaded = context.control_camera.name, location.loaded_goal
    goal = (
        None
        if loaded is None
        else compute_goal(context, loaded, {control: calibrated_arm, **calibrated_others})
    )
    if goal is not None:
        if calibrated_others:
            from .goal_teaching import check_view

            check_view(context, goal.world_T_camera)
        return with_calibrated_depths(context, goal), goal.world_T_camera
    from .goal_teaching import show_goal

    name = "goal" if loaded is None else loaded.name
    goal = show_goal(
        context, location.pose, name, joints, postures, arm, calibrated_arm, calibrated_others
    )
    return with_calibrated_depths(context, goal), location.pose


def compute_goal(
    context: RunSetup,
    loaded_goal: Goal,
    arms: Mapping[str, FreeCameraKinematics | CameraKinematics],
) -> Goal | None:
    """Compute the goal of the loop from a goal that was loaded from a file.

    Return None, so that the goal is taught, in three cases: the file lacks data that the scheme
    needs; it lacks data of a camera with its own target; or the target of the experiment is a
    solid, but the goal in the file was taught with the two plates of the demo.

    arms: kinematics of each camera, as the controller knows them, by name.
    """
    goal = loaded_goal.for_cameras(arms)
    if any(context.has_own_target(n) and n not in loaded_goal.cameras for n in context.needs):
        return None  # for a camera that observes its own target, the goal file has no data
    if goal.target is not None and context.target.shape.is_solid:
        return None
    try:
        context.scheme.check(goal)
    except ConfigurationError:
        return None
    return goal


def with_calibrated_depths(context: RunSetup, goal: Goal) -> Goal:
    """Return a goal whose depths are multiplied by the cameras' setting `calibration_offset.depth`.
    """
    scaled = {
        name: _scale_depth(camera_goal, context.cameras[name].spec.calibration_offset.depth)
        for name, camera_goal in goal.cameras.items() if name in context.cameras
    }  # fmt: skip
    own = scaled.pop(context.control_camera.name)
    return replace(own, other_cameras=scaled) if scaled else own


def _scale_depth(goal: Goal, factor: float) -> Goal:
    """Return a goal with its depth, and the depths of its target plane, multiplied by `factor`."""
    if factor == 1.0:
        return goal
    depth = None if goal.depth is None else goal.depth * factor
    plane = None if goal.plane is None else Plane(*(part / factor for part in goal.plane))
    return replace(goal, depth=depth, plane=plane)
