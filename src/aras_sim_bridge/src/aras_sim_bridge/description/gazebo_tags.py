"""The <gazebo> tags of a URDF: plugins, sensors, materials, link flags."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from xml.etree.ElementTree import Element

from aras_sim_bridge.description import gazebo_materials, grasp_tags, plugins, sensor_tags
from aras_sim_bridge.description.geometry import bounce
from aras_sim_bridge.description.types import (
    CameraDescription,
    ControlPlugin,
    GraspDescription,
    Link,
    Rgba,
    SensorDescription,
)
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base.safe_xml import (
    check_names,
    number,
    shorten,
    text_of,
    truth,
)
from aras_visual_servo_base.urdf import Joint


@dataclass
class GazeboTags:
    """What `parse` found; links are the given ones with their flags set."""

    links: dict[str, Link]
    control_plugins: tuple[ControlPlugin, ...] = ()
    cameras: tuple[CameraDescription, ...] = ()
    sensors: tuple[SensorDescription, ...] = ()
    grasps: tuple[GraspDescription, ...] = ()
    colours: dict[str, Rgba] = field(default_factory=dict)
    static: bool = False


def parse(root: Element, links: dict[str, Link], joints: Mapping[str, Joint],
          warnings: list[str]) -> GazeboTags:
    """Read every `<gazebo>` below `root`.

    A reference to nothing and an unknown plugin or sensor are warnings, as in Gazebo; a tag that
    is understood but wrong is a DescriptionError.
    """
    tags = GazeboTags(dict(links))
    found: list[ControlPlugin | SensorDescription | GraspDescription] = []
    cameras: list[CameraDescription] = []
    sensors: list[SensorDescription] = []
    gauges: dict[str, Element] = {}
    for block in root.findall("gazebo"):
        reference = block.get("reference")
        if reference is None:
            tags.static = truth(text_of(block, "static"), "<gazebo>: static", tags.static)
            found += plugins.read(
                block, "<gazebo>", (ControlPlugin, SensorDescription, GraspDescription), warnings,
                [joint.name for joint in joints.values() if joint.mimic is not None])
        elif reference in links:
            _link_flags(block, reference, tags, warnings)
            sensor_tags.of_link(block, reference, cameras, sensors, found, warnings)
        elif reference in joints:
            for sensor in block.findall("sensor[@type='force_torque']"):
                gauges[reference] = sensor
                found += sensor_tags.gauge(sensor, reference, warnings)
        else:
            warnings.append(
                f"<gazebo reference='{shorten(reference)}'> names no link or joint; ignored"
            )
    check_names([camera.name for camera in cameras], "cameras")
    tags.control_plugins = tuple(one for one in found if isinstance(one, ControlPlugin))
    asked = [one for one in found if isinstance(one, SensorDescription)]
    sensors += sensor_tags.of_model(asked, links, joints, gauges, warnings)
    tags.cameras, tags.sensors = tuple(cameras), tuple(sensors)
    tags.grasps = tuple(grasp_tags.of_model(
        [one for one in found if isinstance(one, GraspDescription)], tags.links, warnings))
    return tags


def _setting(block: Element, tag: str) -> str | None:
    """Text of a child, or its attribute `value`, as old URDF files have it."""
    child = block.find(tag)
    if child is not None and child.get("value") is not None:
        return child.get("value")
    return text_of(block, tag)


def _link_flags(block: Element, name: str, tags: GazeboTags, warnings: list[str]) -> None:
    where = f"<gazebo reference='{name}'>"
    link = tags.links[name]
    material = _setting(block, "material")
    if material:
        tags.colours[name] = gazebo_materials.colour(material, name, warnings)
    gravity = truth(_setting(block, "gravity"), f"{where}: gravity", link.gravity)
    if truth(_setting(block, "turnGravityOff"), f"{where}: turnGravityOff", False):
        gravity = False
    mu = _setting(block, "mu1")
    friction = link.mu if mu is None else number(mu, f"{where}: mu1")
    if friction is not None and friction < 0.0:
        raise DescriptionError(f"{where}: mu1 is {friction}; it must not be negative")
    tags.links[name] = replace(
        link, gravity=gravity, mu=friction,
        # Gazebo copies what <collision> holds into the link's own.
        bounce=next(filter(None, (bounce(one, where) for one in block.findall("collision"))),
                    link.bounce),
        kinematic=truth(_setting(block, "kinematic"), f"{where}: kinematic", link.kinematic),
    )
