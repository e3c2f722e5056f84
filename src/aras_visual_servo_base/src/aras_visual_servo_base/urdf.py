"""Kinematic tree of a URDF: its links and joints, and the path between two links.

The reader follows http://wiki.ros.org/urdf/XML. It reports errors that ROS's parser urdfdom would
ignore or report without a clear message. Inertias, visuals and collisions are read by
`aras_sim_bridge.description`.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from graphlib import CycleError, TopologicalSorter
from types import MappingProxyType
from typing import Self
from xml.etree.ElementTree import Element

from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.poses import Pose, Vector3
from aras_visual_servo_base.safe_xml import (
    find_text,
    parse_direction,
    parse_number,
    parse_numbers,
    shorten,
)

ZERO: Vector3 = (0.0, 0.0, 0.0)
Rgba = tuple[float, float, float, float]  # red, green, blue and opacity of a colour, each 0 to 1
MOVING_KINDS = ("revolute", "continuous", "prismatic")
CAMERA_KINDS = ("camera", "depth", "wideanglecamera", "multicamera")
JOINT_KINDS = (*MOVING_KINDS, "fixed", "floating", "planar")
BOUNDED_KINDS = ("revolute", "prismatic")
# suffixes of the names of a camera's optical frame and camera link
OPTICAL, LINK = "_optical_frame", "_link"


class FramedElement:
    """Base class of elements of a robot description that have a frame.

    The pose of the frame in the parent frame is `origin_xyz` (m) and `origin_rpy` (rad).
    """

    @property
    def pose(self) -> Pose:
        """The pose of the frame in the parent frame."""
        return Pose.from_rpy(self.origin_xyz, self.origin_rpy)

    def with_pose(self, pose: Pose) -> Self:
        """Return a copy of the element with another pose."""
        return replace(self, origin_xyz=pose.xyz, origin_rpy=pose.rpy)


@dataclass(frozen=True)
class JointLimits:
    """Limits of a joint.

    Attributes:
        lower, upper: position limits, rad or m; None for a continuous joint.
        effort: effort limit, N m or N; infinite if a continuous joint has none.
        velocity: velocity limit, rad/s or m/s; infinite if a continuous joint has none.
    """

    lower: float | None
    upper: float | None
    effort: float
    velocity: float


@dataclass(frozen=True)
class SoftLimits:
    """Gains and soft position limits of a `<safety_controller>`; None for a missing limit."""

    lower: float | None
    upper: float | None
    k_position: float
    k_velocity: float


@dataclass(frozen=True)
class Mimic:
    """Coupling of a joint to another one: position = multiplier * position of `joint` + offset."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Joint(FramedElement):
    """A joint of a URDF.

    Attributes:
        kind: revolute, continuous, prismatic, fixed, floating or planar.
        origin_xyz, origin_rpy: pose of the joint frame in the frame of the parent link. The joint
            frame is also the frame of the child link.
        axis: axis of the joint, a unit vector in the joint frame.
        damping: viscous damping, N m s/rad or N s/m.
        friction: Coulomb friction, N m or N.
        stiffness, rest: stiffness of the joint's spring, N m/rad or N/m, and rest position, rad or
            m.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin_xyz: Vector3 = ZERO
    origin_rpy: Vector3 = ZERO
    axis: Vector3 = (1.0, 0.0, 0.0)
    limits: JointLimits | None = None
    damping: float = 0.0
    friction: float = 0.0
    soft_limits: SoftLimits | None = None
    mimic: Mimic | None = None
    stiffness: float = 0.0
    rest: float = 0.0

    @property
    def is_movable(self) -> bool:
        """Whether the joint has one degree of freedom."""
        return self.kind in MOVING_KINDS

    @property
    def stops(self) -> tuple[float, float]:
        """Lower and upper stop, rad or m; infinite for a joint without position limits.

        A stop is 0 if the element `<limit>` does not define it, as URDF prescribes.
        """
        if self.limits is None or self.kind not in BOUNDED_KINDS:
            return -math.inf, math.inf
        return self.limits.lower or 0.0, self.limits.upper or 0.0


@dataclass(frozen=True)
class UrdfTree:
    """Links and joints of a URDF. All mappings are read-only and have the order of the file.

    Attributes:
        root: name of the only link without a parent.
        links: XML elements of the links by name.
        joints: joints by name.
        cameras: for each link with a camera sensor, the pose of its first camera sensor in the
            frame of the link. As in Gazebo, x is forward and z up in the frame of the sensor.
    """

    name: str
    root: str
    links: Mapping[str, Element]
    joints: Mapping[str, Joint]
    cameras: Mapping[str, Pose]

    def find_path(self, base: str, link: str) -> list[Joint]:
        """Return the joints from the link `base` down to `link`. If `base` is '', it is the root.

        Raises:
            DescriptionError: `link` does not exist or is not below `base`; the message suggests the
                most similar name.
        """
        where = f"robot '{shorten(self.name)}'"
        if link not in self.links:
            raise DescriptionError(f"{where} has no link {link}; {suggest(link, self.links)}")
        above = {joint.child: joint for joint in self.joints.values()}
        joints: list[Joint] = []
        at, end = link, base or self.root
        while at != end and at in above:
            joints.append(above[at])
            at = joints[-1].parent
        if at != end:
            known = [joint.parent for joint in reversed(joints)]
            raise DescriptionError(f"{where}: {base} is not an ancestor of {link}; "
                                   f"{suggest(base, known)}")
        return joints[::-1]


@lru_cache(maxsize=8)
def read_robot_name(urdf: str) -> str:
    """Return the name of the robot in a URDF; '' if the text is not a URDF or has no name."""
    try:
        return _read_name(safe_xml.parse(urdf, "URDF"))
    except DescriptionError:
        return ""


@lru_cache(maxsize=8)
def parse_tree(urdf: str) -> UrdfTree:
    """Read the tree of a URDF text; cached, because many runs of a study use the same text.

    The errors are those of `read_tree`.
    """
    return read_tree(safe_xml.parse(urdf, "URDF"))


def read_tree(robot: Element) -> UrdfTree:
    """Read and check the tree of a URDF, without macros of xacro.

    Raises:
        DescriptionError: an element is invalid; the message names the element, the problem and how
            to fix it.
    """
    name = _read_name(robot)
    links: dict[str, Element] = {}
    for element in robot.findall("link"):
        link = element.get("name")
        if not link:
            raise DescriptionError("URDF: a link has no name; give it one")
        if len(link) > 256:
            raise DescriptionError(f"URDF: a link name has {len(link)} characters, must have 1 to "
                                   "256; shorten it")
        if link in links:
            raise DescriptionError(f"URDF: two links are named '{link}'; rename one")
        links[link] = element
    if not links:
        raise DescriptionError(f"URDF: robot '{name}' has no link; add one")
    joints: dict[str, Joint] = {}
    for element in robot.findall("joint"):
        joint = _read_joint(element)
        if joint.name in joints:
            raise DescriptionError(f"URDF: two joints are named '{joint.name}'; rename one")
        joints[joint.name] = joint
    root = _find_root_link(links, joints, f"robot '{shorten(name)}'")
    _check_mimics(joints)
    cameras: dict[str, Pose] = {}
    for block in robot.findall("gazebo[@reference]"):
        link = block.get("reference")
        for sensor in block.findall("sensor"):
            node = sensor.find("camera")
            if sensor.get("type") in CAMERA_KINDS and node is not None and link not in cameras:
                where = f"camera '{shorten(sensor.get('name') or '')}' on link '{shorten(link)}'"
                cameras[link] = Pose.from_rpy(*read_camera_pose(sensor, node, where))
    return UrdfTree(name, root, MappingProxyType(links), MappingProxyType(joints),
                    MappingProxyType(cameras))


def read_camera_pose(sensor: Element, node: Element, where: str) -> tuple[Vector3, Vector3]:
    """Return xyz (m) and rpy (rad) of a camera's pose in the frame of the link with its sensor.

    Args:
        sensor: <sensor> element.
        node: <camera> element of the sensor.
        where: name of the camera, for messages.

    Raises:
        DescriptionError: a pose does not have six numbers.
    """
    at = parse_numbers(find_text(sensor, "pose"), 6, f"{where}: pose", (0.0,) * 6)
    camera_pose = safe_xml.parse_pose(find_text(node, "pose"), f"{where}: camera pose")
    if camera_pose == Pose():
        return at[:3], at[3:]
    both = Pose.from_rpy(at[:3], at[3:]) @ camera_pose
    return both.xyz, both.rpy


def _read_name(robot: Element) -> str:
    if robot.tag != "robot":
        raise DescriptionError(f"URDF: the root element is <{shorten(robot.tag)}>, not <robot>; "
                               "use the URDF of a robot")
    if not robot.get("name"):
        raise DescriptionError("URDF: <robot> has no name; give it one")
    return robot.get("name")


def read_origin(element: Element, where: str) -> tuple[Vector3, Vector3]:
    """Return xyz (m) and rpy (rad) of the <origin> of an element; zeros if there is none."""
    node = element.find("origin")
    if node is None:
        return ZERO, ZERO
    return (
        parse_numbers(node.get("xyz"), 3, f"{where}: origin xyz", ZERO),
        parse_numbers(node.get("rpy"), 3, f"{where}: origin rpy", ZERO),
    )


def _read_joint(element: Element) -> Joint:
    name = element.get("name")
    if not name:
        raise DescriptionError("URDF: a joint has no name; give it one")
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
            raise DescriptionError(f"{where}: it has no <{tag} link=…>; add one")
        ends.append(node.get("link"))
    xyz, rpy = read_origin(element, where)
    axis, node = (1.0, 0.0, 0.0), element.find("axis")
    if node is not None and kind in (*MOVING_KINDS, "planar"):
        axis = parse_direction(node.get("xyz"), f"{where}: axis", axis)
    damping = friction = 0.0
    if (node := element.find("dynamics")) is not None:
        damping = parse_number(node.get("damping"), f"{where}: damping", 0.0)
        friction = parse_number(node.get("friction"), f"{where}: friction", 0.0)
        if damping < 0.0 or friction < 0.0:
            raise DescriptionError(
                f"{where}: damping {damping} and friction {friction} must be ≥ 0"
            )
    mimic = None
    if (node := element.find("mimic")) is not None:
        if not node.get("joint"):
            raise DescriptionError(f"{where}: <mimic> has no attribute joint; add it")
        mimic = Mimic(
            node.get("joint"),
            parse_number(node.get("multiplier"), f"{where}: multiplier", 1.0),
            parse_number(node.get("offset"), f"{where}: offset", 0.0),
        )
    return Joint(name, kind, ends[0], ends[1], xyz, rpy, axis, _read_limits(element, kind, where),
                 damping, friction, _read_soft_limits(element, where), mimic)


def _read_limits(element: Element, kind: str, where: str) -> JointLimits | None:
    node, bounded = element.find("limit"), kind in BOUNDED_KINDS
    if node is None and bounded:
        raise DescriptionError(
            f"{where}: a {kind} joint needs <limit lower= upper= effort= velocity=>"
        )
    if node is None:
        return None
    lower = parse_number(node.get("lower"), f"{where}: limit lower", 0.0)
    upper = parse_number(node.get("upper"), f"{where}: limit upper", 0.0)
    if bounded and lower > upper:
        raise DescriptionError(f"{where}: limit lower {lower} is above upper {upper}; swap them")
    # default of the effort and velocity limits: infinity for a continuous joint; for other joints
    # None, which means that the limits are required
    required = None if bounded else math.inf
    effort = parse_number(node.get("effort"), f"{where}: limit effort", required)
    velocity = parse_number(node.get("velocity"), f"{where}: limit velocity", required)
    # In Gazebo, a negative effort or velocity means that there is no limit.
    effort, velocity = (math.inf if limit < 0.0 else limit for limit in (effort, velocity))
    return JointLimits(lower if bounded else None, upper if bounded else None, effort, velocity)


def _read_soft_limits(element: Element, where: str) -> SoftLimits | None:
    node = element.find("safety_controller")
    if node is None:
        return None
    lower, upper = (
        None if node.get(key) is None else parse_number(node.get(key), f"{where}: {key}")
        for key in ("soft_lower_limit", "soft_upper_limit")
    )
    return SoftLimits(lower, upper,
                      parse_number(node.get("k_position"), f"{where}: k_position", 0.0),
                      parse_number(node.get("k_velocity"), f"{where}: k_velocity"))


def _find_root_link(links: Iterable[str], joints: dict[str, Joint], where: str) -> str:
    """Return the only link without a parent, after checking that the joints form one tree."""
    parents: dict[str, str] = {}
    for joint in joints.values():
        for end in (joint.parent, joint.child):
            if end not in links:
                raise DescriptionError(
                    f"{where}, joint '{joint.name}': link '{shorten(end)}' does not exist; add it "
                    "or correct its name"
                )
        if joint.child in parents:
            raise DescriptionError(f"{where}, joint '{joint.name}': link '{joint.child}' already "
                                   "has a parent; remove one of the two joints")
        parents[joint.child] = joint.parent
    roots = [name for name in links if name not in parents]
    if len(roots) != 1:
        found = ", ".join(f"'{shorten(r)}'" for r in roots[:5]) or "none (the joints form a loop)"
        raise DescriptionError(f"{where}: there must be exactly one link without a parent, found "
                               f"{found}; connect the links by joints")
    if loop := _find_loop(parents):
        raise DescriptionError(
            f"{where}: link '{loop[0]}' is in a loop of joints, not in the tree of '{roots[0]}'; "
            "remove a joint of the loop")
    return roots[0]


def _find_loop(predecessors: Mapping[str, str]) -> list[str]:
    """Return names that form a loop in a mapping from each name to its predecessor; [] for none."""
    try:
        TopologicalSorter({name: [above] for name, above in predecessors.items()}).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def _check_mimics(joints: dict[str, Joint]) -> None:
    leaders = {joint.name: joint.mimic.joint for joint in joints.values()
               if joint.mimic is not None}
    for name, leader in leaders.items():
        if leader not in joints or not joints[leader].is_movable:
            raise DescriptionError(f"joint '{name}': it mimics '{shorten(leader)}', which is not "
                                   "a moving joint of this robot; name another joint")
    if loop := _find_loop(leaders):
        raise DescriptionError(
            f"joint '{loop[0]}': the <mimic> elements form a loop; remove one"
        )
