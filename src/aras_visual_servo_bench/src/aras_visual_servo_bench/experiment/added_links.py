"""Links that an experiment adds to the description of a robot: frames of cameras, and targets."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.poses import xyz_rpy_from_matrix

from ..errors import ExperimentError


@dataclass(frozen=True, eq=False)
class MountedTarget:
    """A target on a link of a robot.

    link: that carries it. pose: link_T_target (4, 4). urdf: what is seen of it.
    """

    link: str
    pose: np.ndarray
    urdf: Path


def with_link(urdf: str, name: str, parent: str, parent_T_link: np.ndarray) -> str:
    """The description with one more link, fixed to another."""
    robot = ElementTree.fromstring(urdf)
    ElementTree.SubElement(robot, "link", name=name)
    _attach(robot, parent, name, parent_T_link)
    return ElementTree.tostring(robot, encoding="unicode")


def _attach(robot: ElementTree.Element, parent: str, child: str, place: np.ndarray) -> None:
    """Fix a link to another, parent_T_child (4, 4)."""
    joint = ElementTree.SubElement(robot, "joint", name=f"{child}_joint", type="fixed")
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    xyz, rpy = (" ".join(map(repr, map(float, part))) for part in xyz_rpy_from_matrix(place))
    ElementTree.SubElement(joint, "origin", xyz=xyz, rpy=rpy)


def with_target(urdf: str, name: str, target: MountedTarget, where: str) -> str:
    """The description with what is seen of a target, fixed to a link; ExperimentError, with the
    description's name `where`, for a link that there is not."""
    robot, drawn = ElementTree.fromstring(urdf), ElementTree.parse(target.urdf).getroot()
    links = {link.get("name") for link in robot.iter("link")}
    if target.link not in links:
        raise ExperimentError(f"{where} has no link '{target.link}' that could carry "
                              f"a target: {suggest(target.link, sorted(links))}")  # fmt: skip
    link = ElementTree.SubElement(robot, "link", name=name)
    link.extend(drawn.iter("visual"))
    for one in drawn.findall("gazebo[@reference]"):
        one.set("reference", name)
        robot.append(one)
    _attach(robot, target.link, name, target.pose)
    return ElementTree.tostring(robot, encoding="unicode")
