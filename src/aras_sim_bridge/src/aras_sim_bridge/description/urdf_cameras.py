"""Reader of a URDF that ignores everything but its cameras."""

import copy
from collections.abc import Iterator
from xml.etree.ElementTree import Element

from aras_sim_bridge.description import camera_tags
from aras_sim_bridge.description.camera_types import CameraDescription
from aras_sim_bridge.description.sdf_dialects import unify
from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.urdf import CAMERA_KINDS


def parse_cameras(xml: str | Element) -> tuple[CameraDescription, ...]:
    """Read only the cameras of a URDF; if several have the same name, return the first.

    Raises:
        DescriptionError: the text is not XML, or an element of a camera is invalid.
    """
    cameras: dict[str, CameraDescription] = {}
    for link, sensor in _list_sensors(safe_xml.parse(xml, "URDF")):
        if sensor.get("type") in CAMERA_KINDS:
            sensor = copy.deepcopy(sensor)
            unify(sensor, [])
            for camera in camera_tags.read_cameras(sensor, link, []):
                cameras.setdefault(camera.name, camera)
    return tuple(cameras.values())


def _list_sensors(robot: Element) -> Iterator[tuple[str, Element]]:
    """Yield the sensors in the `<gazebo>` tags, each with the name of its link."""
    links = {link.get("name") for link in robot.findall("link")}
    for block in robot.findall("gazebo"):
        reference = block.get("reference")
        for place in block.findall("link") if reference is None else (block,):
            link = place.get("name") if reference is None else reference
            if reference is None or reference in links:
                yield from ((link, sensor) for sensor in place.findall("sensor"))
