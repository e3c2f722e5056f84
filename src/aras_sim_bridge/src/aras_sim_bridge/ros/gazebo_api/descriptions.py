"""What a spawn request brings: text, namespace."""

from __future__ import annotations

import re
from dataclasses import replace

from aras_sim_bridge.description import Light, RobotDescription, parse_sdf, parse_urdf, read_sdf
from aras_sim_bridge.description.safe_xml import LARGEST_TEXT
from aras_sim_bridge.errors import DescriptionError


def without_prolog(xml: str) -> str:
    """Return the text without XML declaration and comments, as Gazebo's plugin strips them.

    Raises:
        DescriptionError: when it is too long to be a model, or declares a document type.
    """
    if len(xml) > LARGEST_TEXT:
        raise DescriptionError(f"the model has {len(xml)} characters; the limit is {LARGEST_TEXT}")
    text = re.sub(r"<!--.*?-->", "", xml, flags=re.DOTALL)
    text = re.sub(r"^\s*<\?xml.*?\?>", "", text, flags=re.DOTALL).strip()
    if text.startswith("<!"):
        raise DescriptionError(
            "document type and entity declarations are refused; remove <!DOCTYPE ...>"
        )
    return text


def root_tag(text: str) -> str:
    """Return the name of the first element; '' when there is none."""
    match = re.match(r"<\s*([\w:.-]+)", text)
    return match.group(1) if match else ""


def named_packages(text: str) -> list[str]:
    """Return the packages that package:// paths of the text name."""
    return sorted(set(re.findall(r"package://([^/\"'<\s]*)", text)))


def parse(text: str) -> RobotDescription | Light:
    """Return what one model of URDF, or one model or light of SDF, describes.

    Raises:
        SimError: when it is neither, or wrong, or more than one.
    """
    root = root_tag(text)
    if root == "robot":
        return parse_urdf(text)
    if root in ("sdf", "gazebo"):
        content = read_sdf(text)
        if len(content.lights) == 1 and not content.models:
            return content.lights[0]
        return parse_sdf(text)
    found = f"<{root}>" if root else "no element"
    raise DescriptionError(f"the model's root is {found}; give URDF (<robot>) or SDF (<sdf>)")


def in_namespace(description: RobotDescription, requested: str) -> RobotDescription:
    """The description with its cameras in the namespace of the request, as gazebo_ros gives every
    plugin one that has none. (The control plugin's own, if it has one, is not the cameras'.)"""
    if not requested.strip("/"):
        return description
    cameras = tuple(
        camera if camera.plugin is None or camera.plugin.robot_namespace else
        replace(camera, plugin=replace(camera.plugin, robot_namespace=requested.strip("/")))
        for camera in description.cameras
    )
    return replace(description, cameras=cameras)


def robot_namespace(description: RobotDescription, requested: str) -> str:
    """Return the namespace of a model's controllers: the control plugin's, else the request's."""
    own = [plugin.robot_namespace for plugin in description.control_plugins]
    name = next((value for value in own if value), requested)
    return "/" + name.strip("/") if name.strip("/") else ""
