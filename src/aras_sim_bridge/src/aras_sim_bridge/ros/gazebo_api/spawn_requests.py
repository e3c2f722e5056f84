"""Parsing of the model descriptions, lights and namespaces in spawn requests."""

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
    """Return the root element of an XML text, or an element with an empty tag for an empty text.

    Raises:
        DescriptionError: the text is not valid XML or contains unsafe constructs (see safe_xml).
    """
    return safe_xml.parse(text, "model") if "<" in text else Element("")


def describe_root(root: Element) -> str:
    """Return the name by which error messages refer to a root element."""
    return f"<{safe_xml.shorten(root.tag)}>" if root.tag else "no element"


def find_packages(root: Element) -> list[str]:
    """Return the names of all packages in package:// paths of the document."""
    words = [*root.itertext(), *(text for part in root.iter() for text in part.attrib.values())]
    return sorted(set(re.findall(r"package://([^/\"'<\s]*)", "\n".join(words))))


def parse(root: Element) -> RobotDescription | Light:
    """Parse a URDF model, or an SDF document with a single model or light.

    Raises:
        SimError: the document is neither URDF nor SDF, is invalid, or contains several models.
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
    """Set <robotNamespace> to `requested` in every plug-in that has no such element."""
    for plugin in root.iter("plugin") if requested else ():
        if plugin.find("robotNamespace") is None:
            ElementTree.SubElement(plugin, "robotNamespace").text = requested


def find_namespace(description: RobotDescription, requested: str) -> str:
    """Return the namespace of the controllers, which the control plug-in specifies.

    If the plug-in specifies no namespace, it is `requested`.
    """
    namespaces = [plugin.robot_namespace for plugin in description.control_plugins]
    name = next((namespace for namespace in namespaces if namespace), requested)
    return "/" + name.strip("/") if name.strip("/") else ""
