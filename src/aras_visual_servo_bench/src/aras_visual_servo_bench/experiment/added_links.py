"""Links that an experiment adds to a robot description: for camera frames and for targets."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.urdf_changes import add_fixed_joint

from ..errors import ExperimentError


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
