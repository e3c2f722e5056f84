"""Joints of a robot description that move a camera: their path, and which of them are used."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.poses import optical_pose, xyz_rpy_from_matrix
from aras_visual_servo_base.urdf import LINK, MOVING_KINDS, OPTICAL, Joint, UrdfTree

from ..errors import ConfigurationError


def find_camera_path(tree: UrdfTree, base: str, camera_frame: str) -> list[Joint]:
    """Return the joints from the base to the camera's optical frame (z forward, x right, y down).

    - A link `x_optical_frame`, or any link without a camera sensor, is the optical frame itself.
    - For another link with a camera sensor, the pose of the sensor gives the optical frame.
    - If there is no link `x_optical_frame`, the sensor on the link `x_link` gives the optical
      frame.

    Raises:
        DescriptionError: there is no such frame, or its viewing direction is not known.
    """
    link = camera_frame
    if camera_frame.endswith(OPTICAL):
        link = camera_frame.removesuffix(OPTICAL) + LINK
        if camera_frame in tree.links or link not in tree.links:
            return tree.find_path(base, camera_frame)
    path = tree.find_path(base, link)
    if link not in tree.cameras:
        if link == camera_frame:
            return path
        raise DescriptionError(
            f"the viewing direction of camera_frame '{camera_frame}' is unknown, because link "
            f"'{link}' carries no camera sensor: add the frame '{camera_frame}' (z forward, x "
            "right, y down) to the description, or set camera_frame to such a frame"
        )
    xyz, rpy = xyz_rpy_from_matrix(optical_pose(tree.cameras[link].matrix()))
    frame = camera_frame if camera_frame != link else f"{link}{OPTICAL}"
    return [*path, Joint(f"{link}_to_{frame}", "fixed", link, frame, tuple(xyz), tuple(rpy))]


def check_joint(joint: Joint) -> None:
    """Raise DescriptionError for a joint that moves the camera or target but is not supported."""
    if not joint.is_movable and joint.kind != "fixed":
        raise DescriptionError(
            f"joint '{joint.name}' on the path to the camera is '{joint.kind}': "
            f"only {', '.join(MOVING_KINDS)} and fixed are supported"
        )
    if joint.is_movable and joint.mimic is not None:
        raise DescriptionError(
            f"joint '{joint.name}' mimics another joint and moves the camera, which is not "
            "supported: remove its <mimic> from the description"
        )
    lower, upper, _, _ = read_limits(joint)
    if not lower < upper:
        raise DescriptionError(
            f"joint '{joint.name}': lower limit {lower:g} must be below upper limit {upper:g}"
        )


def read_limits(joint: Joint) -> tuple[float, float, float, float]:
    """Return lower, upper, velocity and effort limits of a joint; a missing limit is infinite."""
    if joint.limits is None:
        return -np.inf, np.inf, np.inf, np.inf
    lower, upper = joint.limits.lower, joint.limits.upper
    return (
        -np.inf if lower is None else lower, np.inf if upper is None else upper,
        joint.limits.velocity, joint.limits.effort,
    )  # fmt: skip


def select_joints(moving: list[Joint], joints: Sequence[str] | None) -> list[Joint]:
    """Return the joints with the given names, in the given order.

    If `joints` is None, return all joints that move the camera or the target.
    """
    if joints is None:
        return moving
    by_name = {joint.name: joint for joint in moving}
    for name in joints:
        if name not in by_name:
            raise ConfigurationError(
                f"no joint {name} moves the camera; {suggest(name, by_name)}"
            )
    if len(set(joints)) != len(joints):
        raise ConfigurationError(f"joints {', '.join(joints)}: a joint is named twice")
    return [by_name[name] for name in joints]
