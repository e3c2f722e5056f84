"""Links that an experiment adds to a robot description: for camera frames and for targets."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.urdf import Joint, parse_tree
from aras_visual_servo_base.urdf_changes import add_fixed_joint
from aras_visual_servo_controller.kinematics.joint_paths import find_camera_path

from ..errors import ExperimentError, catch_setting_errors


@dataclass(frozen=True, eq=False)
class MountedTarget:
    """Target on a link of a robot.

    link: link that carries the target.
    pose: link_T_target (4, 4).
    urdf: file with the visuals of the target.
    """

    link: str
    pose: np.ndarray
    urdf: Path


def with_link(urdf: str, name: str, parent: str, parent_T_link: np.ndarray) -> str:
    """Return the robot description with one more link, fixed to the link `parent`.

    parent_T_link: pose of the new link in its parent (4, 4).
    """
    robot = ElementTree.fromstring(urdf)
    ElementTree.SubElement(robot, "link", name=name)
    add_fixed_joint(robot, parent, name, parent_T_link)
    return ElementTree.tostring(robot, encoding="unicode")


def find_joint_path(urdf: str, camera_frame: str, where: str) -> list[Joint]:
    """Return the joints from the root link of a robot to an optical frame.

    where: name of the robot description, for the error message.

    Raises:
        ExperimentError: there is no such frame.
    """
    with catch_setting_errors(DescriptionError, f"{where}: robot description"):
        return find_camera_path(parse_tree(urdf), "", camera_frame)


def with_frame(
    urdf: str, name: str, frame: str, frame_T_child: np.ndarray, where: str
) -> str:
    """Return the robot description with one more link, fixed to an optical frame.

    If the description has no link for the optical frame, the new link is fixed to the parent of the
    optical frame.

    Args:
        urdf: text of the robot description.
        name: name of the new link.
        frame: name of the optical frame.
        frame_T_child: pose (4, 4) of the new link in the optical frame.
        where: name of the robot description, for the error message.

    Raises:
        ExperimentError: there is no such frame.
    """
    last = find_joint_path(urdf, frame, where)[-1]
    if last.child not in parse_tree(urdf).links:
        frame, frame_T_child = last.parent, last.pose.matrix() @ frame_T_child
    return with_link(urdf, name, frame, frame_T_child)


def with_target(urdf: str, name: str, target: MountedTarget, where: str) -> str:
    """Return the robot description with the visuals of a target, fixed to a link of the robot.

    Args:
        urdf: text of the robot description.
        name: name of the new link.
        where: name of the robot description, for the error message.

    Raises:
        ExperimentError: the robot does not have the link `target.link`.
    """
    robot, target_model = ElementTree.fromstring(urdf), ElementTree.parse(target.urdf).getroot()
    links = {link.get("name") for link in robot.iter("link")}
    if target.link not in links:
        raise ExperimentError(f"{where} has no link '{target.link}' that could carry "
                              f"a target: {suggest(target.link, sorted(links))}")  # fmt: skip
    link = ElementTree.SubElement(robot, "link", name=name)
    link.extend(target_model.iter("visual"))
    for element in target_model.findall("gazebo[@reference]"):
        element.set("reference", name)
        robot.append(element)
    add_fixed_joint(robot, target.link, name, target.pose)
    return ElementTree.tostring(robot, encoding="unicode")
