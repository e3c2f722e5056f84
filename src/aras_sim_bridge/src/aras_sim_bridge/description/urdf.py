"""URDF text -> RobotDescription: the tree, and what each link weighs, shows and touches."""

from types import MappingProxyType
from xml.etree.ElementTree import Element

from aras_sim_bridge.description import gazebo_tags, packages
from aras_sim_bridge.description.geometry import Resolve, urdf_geometry
from aras_sim_bridge.description.inertia import checked_inertial
from aras_sim_bridge.description.types import (
    Collision,
    Link,
    RobotDescription,
    Transmission,
    Visual,
)
from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.safe_xml import number
from aras_visual_servo_base.urdf import origin, parse_tree


def parse_urdf(
    xml: str | Element,
    resolve_package: packages.ResolvePackage = packages.find,
    base_directory: str | None = None,
) -> RobotDescription:
    """Read and check a URDF.

    Args:
        xml: the document, xacro already expanded, or what safe_xml.parse made of it.
        resolve_package: package name -> directory, for `package://` in mesh file names.
        base_directory: what relative mesh paths are relative to; None refuses them.

    Raises:
        DescriptionError: naming the element, what is wrong with it and how to mend it.
    """
    robot = safe_xml.parse(xml, "URDF")
    tree = parse_tree(robot)
    warnings: list[str] = []

    def resolve(uri: str, where: str) -> str:
        return packages.resolve_uri(uri, where, resolve_package, base_directory)

    links = {name: _link(name, node, resolve, warnings) for name, node in tree.links.items()}
    tags = gazebo_tags.parse(robot, links, tree.joints, warnings)
    return RobotDescription(
        name=tree.name,
        root=tree.root,
        links=MappingProxyType(tags.links),
        joints=tree.joints,
        transmissions=tuple(_transmission(e) for e in robot.findall("transmission")),
        control_plugins=tags.control_plugins,
        cameras=tags.cameras,
        sensors=tags.sensors,
        grasps=tags.grasps,
        colours=MappingProxyType(tags.colours),
        static=tags.static,
        warnings=tuple(warnings),
    )


def _link(name: str, element: Element, resolve: Resolve, warnings: list[str]) -> Link:
    where = f"link '{name}'"
    inertial = None
    node = element.find("inertial")
    if node is not None:
        xyz, rpy = origin(node, f"{where}: inertial")
        mass = node.find("mass")
        if mass is None:
            raise DescriptionError(f"{where}: <inertial> has no <mass>")
        tensor = node.find("inertia")
        values = tuple(
            number(None if tensor is None else tensor.get(key), f"{where}: inertia {key}", 0.0)
            for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        )
        inertial = checked_inertial(
            where, number(mass.get("value"), f"{where}: mass value"), xyz, rpy, values, warnings
        )
    visuals, collisions = [], []
    for i, node in enumerate(element.findall("visual")):
        inside = f"{where}, visual {i + 1}"
        shape = urdf_geometry(node, inside, resolve, warnings)
        if shape is not None:
            visuals.append(Visual(node.get("name") or "", *origin(node, inside), shape))
    for i, node in enumerate(element.findall("collision")):
        inside = f"{where}, collision {i + 1}"
        label = node.get("name") or (f"{name}_collision" + (f"_{i}" if i else ""))
        shape = urdf_geometry(node, inside, resolve, warnings)
        if shape is not None:
            collisions.append(Collision(label, *origin(node, inside), shape))
    return Link(name, inertial, tuple(visuals), tuple(collisions))


def _transmission(element: Element) -> Transmission:
    """As written; what is missing stays empty, so that the hardware can say what Gazebo would."""
    name = element.get("name") or ""
    joints, interfaces = [], []
    for node in element.findall("joint"):
        joints.append(node.get("name") or "")
        interfaces += [(n.text or "").strip() for n in node.findall("hardwareInterface")]
    kind = safe_xml.text_of(element, "type") or element.get("type") or ""
    return Transmission(
        name, kind, joints[0] if joints else "", interfaces[0] if interfaces else "",
        bool(element.findall("actuator")), tuple(joints), tuple(interfaces),
    )
