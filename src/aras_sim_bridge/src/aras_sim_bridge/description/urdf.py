"""URDF text -> RobotDescription.

Follows http://wiki.ros.org/urdf/XML; where urdfdom would fail or guess, this says what is wrong.
"""

import math
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from xml.etree.ElementTree import Element

from aras_sim_bridge.description import gazebo_tags, packages, safe_xml
from aras_sim_bridge.description.geometry import Resolve, urdf_geometry
from aras_sim_bridge.description.inertia import checked_inertial
from aras_sim_bridge.description.safe_xml import direction, number, numbers, shorten
from aras_sim_bridge.description.types import (
    ZERO,
    Collision,
    Joint,
    JointLimits,
    Link,
    Mimic,
    RobotDescription,
    SoftLimits,
    Transmission,
    Vector3,
    Visual,
)
from aras_sim_bridge.errors import DescriptionError

JOINT_KINDS = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")


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
    root = safe_xml.parse(xml, "URDF")
    if root.tag != "robot":
        raise DescriptionError(f"URDF: the root element is <{shorten(root.tag)}>, not <robot>")
    name = root.get("name")
    if not name:
        raise DescriptionError("URDF: <robot> has no name")
    warnings: list[str] = []

    def resolve(uri: str, where: str) -> str:
        return packages.resolve_uri(uri, where, resolve_package, base_directory)

    links: dict[str, Link] = {}
    for element in root.findall("link"):
        link = _link(element, resolve, warnings)
        if link.name in links:
            raise DescriptionError(f"URDF: two links are named '{link.name}'; rename one")
        links[link.name] = link
    if not links:
        raise DescriptionError(f"URDF: robot '{name}' has no link")
    joints: dict[str, Joint] = {}
    for element in root.findall("joint"):
        joint = _joint(element)
        if joint.name in joints:
            raise DescriptionError(f"URDF: two joints are named '{joint.name}'; rename one")
        joints[joint.name] = joint
    top = root_link(links, joints, f"robot '{shorten(name)}'")
    _check_mimics(joints)
    tags = gazebo_tags.parse(root, links, joints, warnings)
    return RobotDescription(
        name=name,
        root=top,
        links=MappingProxyType(tags.links),
        joints=MappingProxyType(joints),
        transmissions=tuple(_transmission(e) for e in root.findall("transmission")),
        control_plugins=tags.control_plugins,
        cameras=tags.cameras,
        colours=MappingProxyType(tags.colours),
        static=tags.static,
        warnings=tuple(warnings),
    )


def _origin(element: Element, where: str) -> tuple[Vector3, Vector3]:
    origin = element.find("origin")
    if origin is None:
        return ZERO, ZERO
    return (
        numbers(origin.get("xyz"), 3, f"{where}: origin xyz", ZERO),
        numbers(origin.get("rpy"), 3, f"{where}: origin rpy", ZERO),
    )


def _link(element: Element, resolve: Resolve, warnings: list[str]) -> Link:
    name = element.get("name")
    if not name:
        raise DescriptionError("URDF: a link has no name")
    if len(name) > 256:
        raise DescriptionError(f"URDF: a link name of {len(name)} characters; 256 are enough")
    where = f"link '{name}'"
    inertial = None
    node = element.find("inertial")
    if node is not None:
        xyz, rpy = _origin(node, f"{where}: inertial")
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
        visuals.append(Visual(node.get("name") or "", *_origin(node, inside),
                              urdf_geometry(node, inside, resolve)))
    for i, node in enumerate(element.findall("collision")):
        inside = f"{where}, collision {i + 1}"
        label = node.get("name") or (f"{name}_collision" + (f"_{i}" if i else ""))
        collisions.append(Collision(label, *_origin(node, inside),
                                    urdf_geometry(node, inside, resolve)))
    return Link(name, inertial, tuple(visuals), tuple(collisions))


def _joint(element: Element) -> Joint:
    name = element.get("name")
    if not name:
        raise DescriptionError("URDF: a joint has no name")
    where = f"joint '{shorten(name)}'"
    kind = element.get("type")
    if kind not in JOINT_KINDS:
        raise DescriptionError(
            f"{where}: type '{shorten(str(kind))}' is unknown; use one of {', '.join(JOINT_KINDS)}"
        )
    ends = []
    for tag in ("parent", "child"):
        node = element.find(tag)
        if node is None or not node.get("link"):
            raise DescriptionError(f"{where}: has no <{tag} link=…>")
        ends.append(node.get("link"))
    xyz, rpy = _origin(element, where)
    axis_node = element.find("axis")
    axis = (1.0, 0.0, 0.0)
    if axis_node is not None and kind in ("revolute", "continuous", "prismatic", "planar"):
        axis = direction(axis_node.get("xyz"), f"{where}: axis", axis)
    dynamics = element.find("dynamics")
    damping = friction = 0.0
    if dynamics is not None:
        damping = number(dynamics.get("damping"), f"{where}: damping", 0.0)
        friction = number(dynamics.get("friction"), f"{where}: friction", 0.0)
        if damping < 0.0 or friction < 0.0:
            raise DescriptionError(
                f"{where}: damping {damping} and friction {friction} must be ≥ 0"
            )
    mimic = None
    node = element.find("mimic")
    if node is not None:
        if not node.get("joint"):
            raise DescriptionError(f"{where}: <mimic> names no joint")
        mimic = Mimic(
            node.get("joint"),
            number(node.get("multiplier"), f"{where}: multiplier", 1.0),
            number(node.get("offset"), f"{where}: offset", 0.0),
        )
    return Joint(name, kind, ends[0], ends[1], xyz, rpy, axis, _limits(element, kind, where),
                 damping, friction, _soft_limits(element, where), mimic)


def _limits(element: Element, kind: str, where: str) -> JointLimits | None:
    node = element.find("limit")
    if node is None:
        if kind in ("revolute", "prismatic"):
            raise DescriptionError(
                f"{where}: a {kind} joint needs <limit lower= upper= effort= velocity=>"
            )
        return None
    bounded = kind in ("revolute", "prismatic")
    lower = number(node.get("lower"), f"{where}: limit lower", 0.0)
    upper = number(node.get("upper"), f"{where}: limit upper", 0.0)
    if bounded and lower > upper:
        raise DescriptionError(f"{where}: limit lower {lower} is above upper {upper}")
    required = None if bounded else math.inf  # what a continuous joint leaves open is free
    effort = number(node.get("effort"), f"{where}: limit effort", required)
    velocity = number(node.get("velocity"), f"{where}: limit velocity", required)
    if effort < 0.0 or velocity < 0.0:
        raise DescriptionError(
            f"{where}: limit effort {effort} and velocity {velocity} must not be negative"
        )
    return JointLimits(lower if bounded else None, upper if bounded else None, effort, velocity)


def _soft_limits(element: Element, where: str) -> SoftLimits | None:
    node = element.find("safety_controller")
    if node is None:
        return None
    bounds = [
        None if node.get(key) is None else number(node.get(key), f"{where}: {key}")
        for key in ("soft_lower_limit", "soft_upper_limit")
    ]
    return SoftLimits(bounds[0], bounds[1],
                      number(node.get("k_position"), f"{where}: k_position", 0.0),
                      number(node.get("k_velocity"), f"{where}: k_velocity"))


def root_link(links: dict[str, Link], joints: dict[str, Joint], where: str) -> str:
    """The one link without a parent.

    Raises:
        DescriptionError: a joint's end that is no link, a second parent, a loop, several roots.
    """
    parents: dict[str, str] = {}
    for joint in joints.values():
        for end in (joint.parent, joint.child):
            if end not in links:
                raise DescriptionError(
                    f"{where}, joint '{joint.name}': link '{shorten(end)}' does not exist"
                )
        if joint.child in parents:
            raise DescriptionError(f"{where}, joint '{joint.name}': link '{joint.child}' has a "
                                   "parent already; trees are possible, loops are not")
        parents[joint.child] = joint.parent
    roots = [name for name in links if name not in parents]
    if len(roots) != 1:
        found = ", ".join(f"'{shorten(r)}'" for r in roots[:5]) or "none (the joints form a loop)"
        raise DescriptionError(f"{where}: needs exactly one root link, found {found}")
    lost = _in_a_loop(links, parents)
    if lost is not None:
        raise DescriptionError(
            f"{where}: link '{lost}' is in a loop of joints, not in the tree of '{roots[0]}'")
    return roots[0]


def _in_a_loop(names: Iterable[str], followed: Mapping[str, str]) -> str | None:
    """A name that `followed` leads back to itself or into such a loop; None when there is none."""
    settled: set[str] = set()
    for name in names:
        path: dict[str, None] = {}
        at: str | None = name
        while at is not None and at not in settled:
            if at in path:
                return name
            path[at] = None
            at = followed.get(at)
        settled.update(path)
    return None


def _check_mimics(joints: dict[str, Joint]) -> None:
    leaders = {joint.name: joint.mimic.joint for joint in joints.values()
               if joint.mimic is not None}
    for name, leader in leaders.items():
        if leader not in joints or not joints[leader].moves:
            raise DescriptionError(f"joint '{name}': mimics '{shorten(leader)}', which is not a "
                                   "moving joint of this robot")
    lost = _in_a_loop(leaders, leaders)
    if lost is not None:
        raise DescriptionError(f"joint '{lost}': its mimics form a loop")


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
