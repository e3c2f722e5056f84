"""Teach a goal: compute the desired features from the cameras' views at the goal pose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.poses import inverse, relative_pose
from aras_visual_servo_camera.camera_model import normalise_pixels
from aras_visual_servo_camera.polygons import signed_area
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.observation.camera_rig import CameraKinematics
from aras_visual_servo_controller.observation.feature_observer import observe
from aras_visual_servo_controller.observation.frame import Frame
from aras_visual_servo_controller.observation.observation import SEGMENTED, Need, Observation

from ..errors import ExperimentError, OutOfViewError
from ..experiment import cameras
from ..plants.free_camera_kinematics import FreeCameraKinematics
from ..plants.imaging import capture
from ..targets.geometry import PlacedTarget
from .imaging_setup import make_imaging_settings
from .run_setup import RunSetup

if TYPE_CHECKING:
    from aras_visual_servo_controller.kinematics import Arm

    from .posture_search import PostureSearch

# Data that are measured in a rendered image when a goal is taught. Systematic errors of the image
# processing are then the same at the goal and during the run, so they do not affect the result.
RENDERED_NEEDS = {Need.IMAGE, Need.CONTOUR, Need.CORNERS}
# Maximum difference between the area of the target in the image and the area of the polygon of its
# corners, as a fraction of the area of the polygon.
AREA_TOLERANCE = 0.1
SUSPICIOUS_LENGTH = 1.0  # length of a solid from which its file is assumed to be in millimetres, m
VIEW_REMEDY = "give a goal from which the camera sees the target, or move the target"


def check_view(context: RunSetup, pose: np.ndarray) -> None:
    """Check that the target is in view of each camera that the scheme reads.

    pose: world_T_camera (4, 4) of the control camera.

    Raises:
        ExperimentError: the target is not in view of a camera.
    """
    several = len(context.needs) > 1
    for name in context.needs:
        model, target = context.cameras[name].true_camera, context.targets[name]
        try:
            outline = target.shape.outline(
                target.target_T_camera(context.compute_camera_pose(name, pose))
            )
        except OutOfViewError as error:
            where = f" (camera '{name}')" if several else ""
            raise ExperimentError(
                f"goal: {error}{where}; {_suggest_scale(target) or VIEW_REMEDY}"
            ) from error
        if target.shape.is_solid:
            width, height = np.ptp(model.project_points(outline), axis=0)
            if width > model.width or height > model.height:
                raise ExperimentError(
                    f"goal: the target would be {width:.0f} x {height:.0f} px, larger than the "
                    f"image of {model.width} x {model.height} px; "
                    f"{_suggest_scale(target) or 'give a goal from farther away'}"
                )
        if context.experiment.has_images:
            is_visible = (cameras.draw_outline(outline, model) < cameras.WHITE_LEVEL).any()
        else:
            is_visible = context.experiment.ideal.unbounded or cameras.is_in_view(
                outline, model, 0.0
            )
        if is_visible:
            continue
        first = context.control_camera.name
        if name == first:
            view = f"view of camera '{name}'" if several else "the camera's view"
            raise ExperimentError(f"goal: the target is not in {view}; {VIEW_REMEDY}")
        raise ExperimentError(
            f"goal: the target is in view of camera '{first}', but not of camera '{name}'; turn or "
            f"move camera '{name}', or {VIEW_REMEDY}"
        )


def needs_images(context: RunSetup) -> bool:
    """Return True if the goal is taught with rendered images."""
    experiment = context.experiment
    if experiment.plant != "bullet" or not experiment.has_images:
        return False
    needs = frozenset().union(*context.needs.values())
    solid = any(context.targets[name].shape.is_solid for name in context.needs)
    # A target in the robot description may differ from the experiment's corners, so its contour and
    # corners are measured in a rendered image.
    in_description = any(context.find_target_spec(name).is_in_description for name in context.needs)
    rendered = (
        RENDERED_NEEDS | SEGMENTED
        if solid or context.labelled_link or in_description
        else RENDERED_NEEDS
    )
    return bool(needs & rendered)


def show_goal(
    context: RunSetup,
    pose: np.ndarray,
    name: str,
    joints: np.ndarray | None,
    postures: PostureSearch | None,
    arm: Arm | FreeCameraKinematics,
    calibrated_arm: Arm | FreeCameraKinematics,
    others: Mapping[str, CameraKinematics | FreeCameraKinematics],
) -> Goal:
    """Teach a goal at a camera pose, with rendered images if the features need them.

    Args:
        pose: true world_T_camera (4, 4) of the control camera.
        name: name of the goal.
        joints: joint positions (n,) at the goal; None: not known.
        postures: search for postures of the arm; None for a free camera.
        arm: true kinematics of the control camera.
        calibrated_arm: kinematics of the control camera, as the controller knows them.
        others: kinematics of the other cameras, as the controller knows them, by name.

    Raises:
        ExperimentError: the target is not in view of a camera.
    """
    check_view(context, pose)
    control, images = context.control_camera.name, {}
    if needs_images(context):
        from .dynamic_arm_setup import take_goal_images

        images = take_goal_images(
            context, postures.find_joints(pose) if joints is None else joints
        )
    positions = {} if joints is None else dict(zip(arm.names, joints.tolist(), strict=True))
    rest, mountings = np.zeros(len(arm.names)), {control: np.eye(4)}
    if calibrated_arm is not arm:
        mountings[control] = inverse(arm.pose(rest)) @ calibrated_arm.pose(rest)
    for camera, other in others.items():
        mountings[camera] = relative_pose(
            context.compute_camera_pose(camera, arm.pose(rest)), other.pose(rest)
        )
    return teach_goal(context, pose, mountings, others, images, name, positions)


def teach_goal(
    context: RunSetup,
    pose: np.ndarray,
    mountings: Mapping[str, np.ndarray],
    other_kinematics: Mapping[str, CameraKinematics | FreeCameraKinematics],
    images: Mapping[str, Frame],
    name: str,
    joints: Mapping[str, float],
) -> Goal:
    """Compute the goal from the views of the cameras at the goal pose.

    Args:
        pose: true world_T_camera (4, 4) of the control camera.
        mountings: pose (4, 4) of each camera according to its calibration, in the frame of the true
            camera, by name.
        other_kinematics: kinematics of the other cameras, as the controller knows them, by name.
        images: image of each camera, by name; for a camera without an image, features are computed
            from the geometry.
        name: name of the goal.
        joints: position of each joint at the goal, by name; empty: not known.
    """
    rig = context.settings.make_camera_rig(
        {**dict.fromkeys(mountings), **other_kinematics}, context.scheme
    )
    views: dict[str, Observation] = {}
    for camera, observer in rig.observers.items():
        setup, target = context.cameras[camera], context.targets[camera]
        reading, true_pose = images.get(camera), context.compute_camera_pose(camera, pose)
        if reading is None:
            imaging = make_imaging_settings(context, setup, is_teaching=True)
            reading = capture(imaging, pose)
        calibrated = true_pose @ mountings[camera]
        plane = target.shape.plane
        if Need.MOMENTS in observer.needs and Need.CORNERS not in observer.needs:
            plane = target.shape.outline_plane
        views[camera] = observe(
            reading, None, observer, setup.calibrated_camera, world_T_camera=calibrated,
            plane=plane(target.target_T_camera(calibrated)),
        )  # fmt: skip
        if camera in images:
            _check_is_target(context, views[camera], true_pose)
    control, target = views.pop(rig.control.name), context.target
    depth = target.shape.depth(target.target_T_camera(control.world_T_camera))
    if target.shape.is_solid:
        depth = None  # with None, `Goal.teach` uses the depth of `observation.plane`
    observation = rig.merge_observations(control, views) if views else control
    return replace(Goal.teach(context.scheme, observation, name, depth), joints=dict(joints))


def _check_is_target(context: RunSetup, observation: Observation, pose: np.ndarray) -> None:
    """Check that the target detected in an image is at the true position of the target.

    pose: true world_T_camera (4, 4) of the camera.

    Raises:
        ExperimentError: the position or the area of the detected object is wrong.
    """
    area = None
    if observation.moments is not None:
        area = observation.moments.m00
    elif observation.contour is not None:
        area = abs(signed_area(observation.contour))
    if area is None:
        return
    camera, target = context.cameras[observation.name], context.targets[observation.name]
    outline = target.shape.outline(target.target_T_camera(pose))
    pixels = camera.true_camera.project_points(outline)
    corners = normalise_pixels(pixels, camera.true_camera, camera.calibrated_camera, is_closed=True)
    (left, top), (right, bottom) = corners.min(axis=0), corners.max(axis=0)
    found = observation.moments
    if found and not (left <= found.xg <= right and top <= found.yg <= bottom):
        raise ExperimentError(
            "goal: another object is detected as the target, because it has the target's colour "
            "(possibly the arm's hand); keep it out of the image, or give it another colour"
        )
    ratio = area / abs(signed_area(corners))
    if (
        context.find_target_spec(observation.name).is_in_description
        and abs(ratio - 1.0) > AREA_TOLERANCE
    ):
        raise ExperimentError(
            f"goal: the target's area in the image is {ratio:.2f} times the area of the polygon "
            "of its corners (at z = 0); correct the corners, or, if the target is a link of the "
            "robot description, set target.link to this link"
        )


def _suggest_scale(target: PlacedTarget) -> str:
    """Return a remedy if a solid is probably modelled in millimetres, else ''."""
    if not target.shape.is_solid:
        return ""
    length = float(np.ptp(target.shape.solid.vertices, axis=0).max())
    if length < SUSPICIOUS_LENGTH:
        return ""
    return f"the mesh is {length:.3g} m long; if it is in millimetres, set target.scale to 0.001"
