"""What the cameras see at a goal that is shown, as the controller takes it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.poses import inverse, relative_pose
from aras_visual_servo_camera.polygons import signed_area
from aras_visual_servo_camera.undistortion import normalise_pixels
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.observation.camera_rig import CameraKinematics
from aras_visual_servo_controller.observation.feature_observer import observe
from aras_visual_servo_controller.observation.frame import Frame
from aras_visual_servo_controller.observation.observation import SEGMENTED, Need, Observation

from ..errors import ExperimentError, ViewError
from ..experiment import cameras
from ..plants.free_body import FreeBody
from ..plants.imaging import capture
from ..targets.geometry import PlacedTarget
from .imaging_setup import make_imaging_settings
from .setup_context import SetupContext

if TYPE_CHECKING:
    from aras_visual_servo_controller.kinematics import Arm

    from .postures import Postures

# What is taught from a picture as the loop will see it: its own errors are then none of the goal.
RENDERED_NEEDS = {Need.IMAGE, Need.CONTOUR, Need.CORNERS}
AREA_TOLERANCE = 0.1  # part of an area by which a described target may differ from its corners
SUSPICIOUS_LENGTH = 1.0  # m, of a solid that is more likely in millimetres
VIEW_REMEDY = "give a goal from where the camera sees it, or move the target"


def check_view(context: SetupContext, pose: np.ndarray) -> None:
    """ExperimentError where the target is not in view of a camera that the scheme reads.

    pose: world_T_camera (4, 4) of the control camera.
    """
    several = len(context.needs) > 1
    for name in context.needs:
        eye, target = context.cameras[name], context.targets[name]
        try:
            outline = target.shape.outline(
                target.target_T_camera(context.compute_camera_pose(name, pose))
            )
        except ViewError as error:
            where = f" (camera '{name}')" if several else ""
            raise ExperimentError(
                f"goal: {error}{where}: {_suggest_scale(target) or VIEW_REMEDY}"
            ) from error
        if target.shape.is_solid:
            across, down = np.ptp(np.column_stack(eye.true_camera.project(*outline.T)), axis=0)
            if across > eye.true_camera.width or down > eye.true_camera.height:
                raise ExperimentError(
                    f"the goal is shown where the target is {across:.0f} x {down:.0f} px, "
                    f"larger than the view of {eye.true_camera.width} x {eye.true_camera.height} "
                    "px: "
                    f"{_suggest_scale(target) or 'give a goal from farther away'}"
                )
        if context.experiment.has_images:
            seen = (cameras.draw_outline(outline, eye.true_camera) < cameras.WHITE_LEVEL).any()
        else:
            seen = context.experiment.ideal.unbounded or cameras.is_in_view(
                outline, eye.true_camera, 0.0
            )
        if seen:
            continue
        first = context.control_camera.name
        if name == first:
            by = f"view of camera '{name}'" if several else "the camera's view"
            raise ExperimentError(
                f"the goal is shown where the target is not in {by}: {VIEW_REMEDY}"
            )
        raise ExperimentError(
            f"the goal is shown where camera '{first}' sees the target and it is not in view "
            f"of camera '{name}': their views do not overlap there: turn or move camera "
            f"'{name}', or {VIEW_REMEDY}"
        )


def needs_images(context: SetupContext) -> bool:
    """Whether the goal is taught by rendered images."""
    experiment = context.experiment
    if experiment.plant != "bullet" or not experiment.has_images:
        return False
    needs = frozenset().union(*context.needs.values())
    solid = any(context.targets[name].shape.is_solid for name in context.needs)
    # A target of the robot's own description is drawn, not put where its corners say.
    described = any(context.find_target_spec(name).is_in_description for name in context.needs)
    drawn = (
        RENDERED_NEEDS | SEGMENTED
        if solid or context.labelled_link or described
        else RENDERED_NEEDS
    )
    return bool(needs & drawn)


def show_goal(
    context: SetupContext, pose: np.ndarray, name: str, joints: np.ndarray | None,
    postures: Postures | None, arm: Arm | FreeBody, believed: Arm | FreeBody,
    others: Mapping[str, CameraKinematics | FreeBody],
) -> Goal:
    """Teach a goal where it is shown; ExperimentError where the cameras do not see the target.

    Args:
        pose: world_T_camera (4, 4) of the true control camera.
        name: of the goal.
        joints: (n,) of the arm there; None: not known. postures: of the arm, if there is one.
        arm, believed: true and believed. others: what is believed to move the other cameras.
    """
    check_view(context, pose)
    control, images = context.control_camera.name, {}
    if needs_images(context):
        from .dynamic_arm_setup import take_first_images

        images = take_first_images(
            context, postures.find_joints(pose) if joints is None else joints
        )
    there = {} if joints is None else dict(zip(arm.names, joints.tolist(), strict=True))
    rest, mountings = np.zeros(len(arm.names)), {control: np.eye(4)}
    if believed is not arm:
        mountings[control] = inverse(arm.pose(rest)) @ believed.pose(rest)
    for camera, other in others.items():
        mountings[camera] = relative_pose(
            context.compute_camera_pose(camera, arm.pose(rest)), other.pose(rest)
        )
    return teach_goal(context, pose, mountings, others, images, name, there)


def teach_goal(
    context: SetupContext,
    pose: np.ndarray,
    mountings: Mapping[str, np.ndarray],
    other_kinematics: Mapping[str, CameraKinematics | FreeBody],
    images: Mapping[str, Frame],
    name: str,
    joints: Mapping[str, float],
) -> Goal:
    """What the controller makes of the true cameras' views at the goal.

    Args:
        pose: world_T_camera (4, 4) of the true control camera.
        mountings: (4, 4) of each believed camera in the true one, by name.
        others: what is believed to move the other cameras.
        images: of the cameras, by name; they see exactly where there is none.
        name: of the goal.
        joints: there, by name; empty: they are not known.
    """
    rig = context.settings.make_camera_rig(
        {**dict.fromkeys(mountings), **other_kinematics}, context.scheme
    )
    views: dict[str, Observation] = {}
    for camera, observer in rig.observers.items():
        eye, target = context.cameras[camera], context.targets[camera]
        reading, true_pose = images.get(camera), context.compute_camera_pose(camera, pose)
        if reading is None:
            sight = make_imaging_settings(context, eye, is_teaching=True)
            reading = capture(sight, pose)
        believed = true_pose @ mountings[camera]
        plane = target.shape.plane
        if Need.MOMENTS in observer.needs and Need.CORNERS not in observer.needs:
            plane = target.shape.outline_plane
        views[camera] = observe(
            reading, None, observer, eye.calibrated_camera, world_T_camera=believed,
            plane=plane(target.target_T_camera(believed)),
        )  # fmt: skip
        if camera in images:
            _check_is_target(context, views[camera], true_pose)
    control, target = views.pop(rig.control.name), context.target
    depth = target.shape.depth(target.target_T_camera(control.world_T_camera))
    if target.shape.is_solid:
        depth = None  # its plane's
    observation = rig.merge_observations(control, views) if views else control
    return replace(Goal.teach(context.scheme, observation, name, depth), joints=dict(joints))


def _check_is_target(context: SetupContext, observation: Observation, pose: np.ndarray) -> None:
    """ExperimentError where an image's target is not where the true one is.

    pose: world_T_camera (4, 4) of the true camera.
    """
    area = None
    if observation.moments is not None:
        area = observation.moments.m00
    elif observation.contour is not None:
        area = abs(signed_area(observation.contour))
    if area is None:
        return
    eye, target = context.cameras[observation.name], context.targets[observation.name]
    outline = target.shape.outline(target.target_T_camera(pose))
    pixels = np.column_stack(eye.true_camera.project(*outline.T))
    corners = normalise_pixels(pixels, eye.true_camera, eye.calibrated_camera, is_closed=True)
    (left, top), (right, bottom) = corners.min(axis=0), corners.max(axis=0)
    found = observation.moments
    if found and not (left <= found.xg <= right and top <= found.yg <= bottom):
        raise ExperimentError(
            "goal: what the camera takes for the target is not where the target is: something "
            "else of its colour is in view, as the arm's hand may be; keep that out of the "
            "picture, or give it another colour"
        )
    times = area / abs(signed_area(corners))
    if (
        context.find_target_spec(observation.name).is_in_description
        and abs(times - 1.0) > AREA_TOLERANCE
    ):
        raise ExperimentError(
            f"goal: the target is {times:.2f} times as large in the picture as its corners, "
            "which are flat and at the height z = 0: where it is a link of the robot's "
            "description, name that, target: {link: NAME}"
        )


def _suggest_scale(target: PlacedTarget) -> str:
    """What to do of a solid that is too large to be in metres, in words; '': it may well be."""
    if not target.shape.is_solid:
        return ""
    length = float(np.ptp(target.shape.solid.vertices, axis=0).max())
    if length < SUSPICIOUS_LENGTH:
        return ""
    return f"its mesh is {length:.3g} m long; where it is in millimetres, set target.scale to 0.001"
