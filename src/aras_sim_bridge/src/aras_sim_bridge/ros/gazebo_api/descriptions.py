"""What a spawn request brings: a model or a light, a namespace."""

from __future__ import annotations

import re
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from aras_sim_bridge.description import (
    Light,
    RobotDescription,
    parse_sdf,
    parse_urdf,
    read_sdf,
)
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base import safe_xml


def parse_root(text: str) -> Element:
    """Return the root of a model's text; one without a name where there is no element at all.

    Raises:
        DescriptionError: it is no XML, or none that a stranger may send (see safe_xml).
    """
    return safe_xml.parse(text, "model") if "<" in text else Element("")


def describe_root(root: Element) -> str:
    """Return a root as messages name it."""
    return f"<{safe_xml.shorten(root.tag)}>" if root.tag else "no element"


def find_packages(root: Element) -> list[str]:
    """Return the packages that package:// paths in the document name."""
    words = [*root.itertext(), *(text for part in root.iter() for text in part.attrib.values())]
    return sorted(set(re.findall(r"package://([^/\"'<\s]*)", "\n".join(words))))


def parse(root: Element) -> RobotDescription | Light:
    """Return what one model of URDF, or one model or light of SDF, describes.

    Raises:
        SimError: when it is neither, or wrong, or more than one.
    """
    if root.tag == "robot":
        return parse_urdf(root)
    if root.tag in ("sdf", "gazebo"):
        content = read_sdf(root)
        if len(content.lights) == 1 and not content.models:
            return content.lights[0]
        return parse_sdf(root)
    raise DescriptionError(
        f"the model's root is {describe_root(root)}; give URDF (<robot>) or SDF (<sdf>)"
    )


def set_namespace(root: Element, requested: str) -> None:
    """Give the requested namespace to every plug-in that names none, as gazebo_ros does."""
    for plugin in root.iter("plugin") if requested else ():
        if plugin.find("robotNamespace") is None:
            ElementTree.SubElement(plugin, "robotNamespace").text = requested


def find_namespace(description: RobotDescription, requested: str) -> str:
    """Return the namespace of a model's controllers: the control plugin's, else the request's."""
    own = [plugin.robot_namespace for plugin in description.control_plugins]
    name = next((value for value in own if value), requested)
    return "/" + name.strip("/") if name.strip("/") else ""
