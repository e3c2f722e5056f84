"""Readers of the name and the pose of an SDF element, and a writer of its pose."""

from collections.abc import Mapping
from types import MappingProxyType
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from aras_sim_bridge.description.sdf_dialects import MODEL_FRAME
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.poses import Pose
from aras_visual_servo_base.safe_xml import find_text, shorten

_IDENTITY_FRAMES = MappingProxyType({"world": Pose(), MODEL_FRAME: Pose()})


def read_name(element: Element, where: str) -> str:
    """Return the name of an element."""
    name = element.get("name")
    if not name or len(name) > 256:
        raise DescriptionError(f"{where}: a <{element.tag}> needs a name of 1 to 256 characters")
    return name


def read_pose(element: Element, where: str, frames: Mapping[str, Pose] = _IDENTITY_FRAMES) -> Pose:
    """Return the pose of an element relative to its parent element.

    Args:
        frames: frames that the pose may refer to, by name, as poses relative to the parent element.
    """
    node = element.find("pose")
    if node is None:
        return Pose()
    frame = node.get("relative_to") or node.get("frame") or "world"
    try:
        base = frames[frame]
    except KeyError:
        raise DescriptionError(
            f"{where}: <pose relative_to='{shorten(frame)}'> names no link, joint, frame or model "
            "of the same parent; correct the name, or give the pose relative to the parent element"
        ) from None
    return base @ safe_xml.parse_pose(find_text(element, "pose"), f"{where}: pose")


def write_pose(element: Element, pose: Pose, frame: str = "") -> None:
    """Replace the pose of an element; it is relative to `frame`, or to the parent element if ''."""
    for old in element.findall("pose"):
        element.remove(old)
    node = ElementTree.SubElement(element, "pose")
    node.text = " ".join(map(repr, (*pose.xyz, *pose.rpy)))
    if frame:
        node.set("relative_to", frame)
