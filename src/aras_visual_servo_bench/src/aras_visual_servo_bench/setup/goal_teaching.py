"""What the cameras see at a goal that is shown, as the controller takes it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.poses import inverse, relative
from aras_visual_servo_camera.polygons import signed_area
from aras_visual_servo_camera.undistortion import normalise_pixels
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.seeing.frame import Frame
from aras_visual_servo_controller.seeing.observation import SEGMENTED, Need, Observation
from aras_visual_servo_controller.seeing.observer import observe
from aras_visual_servo_controller.seeing.rig import MovedBy

from ..asked import cameras
from ..errors import ExperimentError, ViewError
from ..plants.free_body import FreeBody
from ..plants.sight import capture
from ..targets.geometry import PlacedTarget
from .setup_context import SetupContext
from .sights import make_sight

if TYPE_CHECKING:
    from aras_visual_servo_controller.arm import Arm

    from .postures import Postures

# What is taught from a picture as the loop will see it: its own errors are then none of the goal.
PICTURED = {Need.IMAGE, Need.CONTOUR, Need.CORNERS}
SAME_SIZE = 0.1  # part of an area by which a described target may differ from its corners
LONG = 1.0  # m, of a solid that is more likely in millimetres
ELSEWHERE = "give a goal from where the camera sees it, or move the target"


def check_view(context: SetupContext, pose: np.ndarray) -> None:
    """ExperimentError where the target is not in view of a camera that the scheme reads.

    pose: world_T_camera (4, 4) of the control camera.
    """
    several = len(context.needs) > 1
    for name in context.needs:
        eye, target = context.eyes[name], context.targets[name]
        try:
            outline = target.shape.outline(target.seen_from(context.pose_of(name, pose)))
        except ViewError as error:
            where = f" (camera '{name}')" if several else ""
            raise ExperimentError(
                f"goal: {error}{where}: {_too_long(target) or ELSEWHERE}"
            ) from error
        if target.shape.is_solid:
            across, down = np.ptp(np.column_stack(eye.true.project(*outline.T)), axis=0)
            if across > eye.true.width or down > eye.true.height:
                raise ExperimentError(
                    f"the goal is shown where the target is {across:.0f} x {down:.0f} px, "
                    f"larger than the view of {eye.true.width} x {eye.true.height} px: "
                    f"{_too_long(target) or 'give a goal from farther away'}"
                )
        if context.experiment.pictures:
            seen = (cameras.draw(outline, eye.true) < cameras.WHITE).any()
        else:
            seen = context.experiment.ideal.unbounded or cameras.in_view(outline, eye.true, 0.0)
        if seen:
            continue
        first = context.control.name
        if name == first:
            by = f"view of camera '{name}'" if several else "the camera's view"
            raise ExperimentError(
                f"the goal is shown where the target is not in {by}: {ELSEWHERE}"
            )
        raise ExperimentError(
            f"the goal is shown where camera '{first}' sees the target and it is not in view "
            f"of camera '{name}': their views do not overlap there: turn or move camera "
            f"'{name}', or {ELSEWHERE}"
        )


def needs_images(context: SetupContext) -> bool:
    """Whether the goal is taught by rendered images."""
    experiment = context.experiment
    if experiment.plant != "bullet" or not experiment.pictures:
        return False
    needs = frozenset().union(*context.needs.values())
    solid = any(context.targets[name].shape.is_solid for name in context.needs)
    # A target of the robot's own description is drawn, not put where its corners say.
    described = any(context.target_spec(name).described for name in context.needs)
    drawn = PICTURED | SEGMENTED if solid or context.label or described else PICTURED
    return bool(needs & drawn)


def show_goal(
    context: SetupContext, pose: np.ndarray, name: str, joints: np.ndarray | None,
    postures: Postures | None, arm: Arm | FreeBody, believed: Arm | FreeBody,
    others: Mapping[str, MovedBy | FreeBody],
) -> Goal:
    """Teach a goal where it is shown; ExperimentError where the cameras do not see the target.

    Args:
        pose: world_T_camera (4, 4) of the true control camera.
        name: of the goal.
        joints: (n,) of the arm there; None: not known. postures: of the arm, if there is one.
        arm, believed: true and believed. others: what is believed to move the other cameras.
    """
    check_view(context, pose)
    control, images = context.control.name, {}
    if needs_images(context):
        from .bullet_setup import take_first_images

        images = take_first_images(context, postures.at(pose) if joints is None else joints)
    there = {} if joints is None else dict(zip(arm.names, joints.tolist(), strict=True))
    rest, mountings = np.zeros(len(arm.names)), {control: np.eye(4)}
    if believed is not arm:
        mountings[control] = inverse(arm.pose(rest)) @ believed.pose(rest)
    for camera, other in others.items():
        mountings[camera] = relative(context.pose_of(camera, arm.pose(rest)), other.pose(rest))
    return teach_goal(context, pose, mountings, others, images, name, there)


def teach_goal(
    context: SetupContext,
    pose: np.ndarray,
    mountings: Mapping[str, np.ndarray],
    others: Mapping[str, MovedBy | FreeBody],
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
    rig = context.settings.rig({**dict.fromkeys(mountings), **others}, context.scheme)
    views: dict[str, Observation] = {}
    for camera, observer in rig.observers.items():
        eye, target = context.eyes[camera], context.targets[camera]
        reading, true_pose = images.get(camera), context.pose_of(camera, pose)
        if reading is None:
            sight = make_sight(context, eye, exactly=True)
            reading = capture(sight, pose)
        believed = true_pose @ mountings[camera]
        plane = target.shape.plane
        if Need.MOMENTS in observer.needs and Need.CORNERS not in observer.needs:
            plane = target.shape.outline_plane
        views[camera] = observe(
            reading, None, observer, eye.believed, world_T_camera=believed,
            plane=plane(target.seen_from(believed)),
        )  # fmt: skip
        if camera in images:
            _check_is_target(context, views[camera], true_pose)
    control, target = views.pop(rig.control.name), context.target
    depth = target.shape.depth(target.seen_from(control.world_T_camera))
    if target.shape.is_solid:
        depth = None  # its plane's
    observation = rig.together(control, views) if views else control
    return replace(Goal.teach(context.scheme, observation, name, depth), joints=dict(joints))


def _check_is_target(context: SetupContext, seen: Observation, pose: np.ndarray) -> None:
    """ExperimentError where an image's target is not where the true one is.

    pose: world_T_camera (4, 4) of the true camera.
    """
    area = None
    if seen.moments is not None:
        area = seen.moments.m00
    elif seen.contour is not None:
        area = abs(signed_area(seen.contour))
    if area is None:
        return
    eye, target = context.eyes[seen.name], context.targets[seen.name]
    outline = target.shape.outline(target.seen_from(pose))
    pixels = np.column_stack(eye.true.project(*outline.T))
    corners = normalise_pixels(pixels, eye.true, eye.believed, closed=True)
    (left, top), (right, bottom) = corners.min(axis=0), corners.max(axis=0)
    found = seen.moments
    if found and not (left <= found.xg <= right and top <= found.yg <= bottom):
        raise ExperimentError(
            "goal: what the camera takes for the target is not where the target is: something "
            "else of its colour is in view, as the arm's hand may be; keep that out of the "
            "picture, or give it another colour"
        )
    times = area / abs(signed_area(corners))
    if context.target_spec(seen.name).described and abs(times - 1.0) > SAME_SIZE:
        raise ExperimentError(
            f"goal: the target is {times:.2f} times as large in the picture as its corners, "
            "which are flat and at the height z = 0: where it is a link of the robot's "
            "description, name that, target: {link: NAME}"
        )


def _too_long(target: PlacedTarget) -> str:
    """What to do of a solid that is too large to be in metres, in words; '': it may well be."""
    if not target.shape.is_solid:
        return ""
    length = float(np.ptp(target.shape.solid.vertices, axis=0).max())
    if length < LONG:
        return ""
    return f"its mesh is {length:.3g} m long; where it is in millimetres, set target.scale to 0.001"
