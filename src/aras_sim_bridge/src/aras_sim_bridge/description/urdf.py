"""Reader that converts the text of a URDF to a RobotDescription."""

from dataclasses import replace
from types import MappingProxyType
from xml.etree.ElementTree import Element

from aras_sim_bridge.description import gazebo_tags, packages, supported_elements
from aras_sim_bridge.description.angle_unit_check import (
    describe_angles_in_degrees,
    describe_limits_in_degrees,
)
from aras_sim_bridge.description.geometry_tags import Resolve, read_geometry
from aras_sim_bridge.description.inertia import make_inertial
from aras_sim_bridge.description.kinematic_tree import WORLD, JointInModel, assemble
from aras_sim_bridge.description.sdf_joints import NO_LIMIT
from aras_sim_bridge.description.sdf_model import split_model
from aras_sim_bridge.description.types import (
    Collision,
    Link,
    RobotDescription,
    Transmission,
    Visual,
)
from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.errors import DescriptionError
from aras_visual_servo_base.poses import Pose, quaternion_from_z_to, rotate
from aras_visual_servo_base.safe_xml import parse_number, parse_numbers
from aras_visual_servo_base.urdf import (
    ZERO,
    Joint,
    JointLimits,
    UrdfTree,
    read_origin,
    read_tree,
)


def parse_urdf(
    xml: str | Element,
    resolve_package: packages.ResolvePackage = packages.find_package,
    base_directory: str | None = None,
) -> RobotDescription:
    """Read and check a URDF.

    Args:
        xml: the document with xacro already expanded, or the element that `safe_xml.parse`
            returned for it.
        resolve_package: function that returns the directory of a package, for `package://` in mesh
            file names.
        base_directory: folder to which relative mesh paths are relative; None rejects them.

    Raises:
        DescriptionError: an element is invalid; the message names the element, the problem and how
            to fix it.
    """
    robot = safe_xml.parse(xml, "URDF")
    tree = read_tree(robot)
    warnings: list[str] = []

    def resolve(uri: str, where: str) -> str:
        return packages.resolve_uri(uri, where, resolve_package, base_directory)

    links = {name: _read_link(name, node, resolve, warnings) for name, node in tree.links.items()}
    for joint in tree.joints.values():
        if joint.kind == "revolute":
            low, high = joint.stops
            warnings += describe_limits_in_degrees(low, high, f"joint '{joint.name}'")
    for node in (*robot.findall("link"), *robot.findall("joint")):
        for place in node.iter("origin"):
            where = f"{node.tag} '{node.get('name')}': origin rpy"
            warnings += describe_angles_in_degrees(
                parse_numbers(place.get("rpy"), 3, where, ZERO), where
            )
    poses = _compute_link_poses(tree)
    tags = gazebo_tags.parse(robot, links, tree.joints, poses, resolve, warnings)
    warnings += supported_elements.describe_ignored_elements(
        robot, "robot", f"robot '{safe_xml.shorten(tree.name)}'"
    )
    _unfold_planar(tags)
    whole = RobotDescription(
        name=tree.name,
        root=tree.root,
        links=MappingProxyType(tags.links),
        joints=MappingProxyType(tags.joints),
        transmissions=tuple(_read_transmission(e) for e in robot.findall("transmission")),
        control_plugins=tags.control_plugins,
        cameras=tags.cameras,
        sensors=tags.sensors,
        grasps=tags.grasps,
        colours=MappingProxyType(tags.colours),
        static=tags.static,
        warnings=tuple(warnings),
    )
    floats = any(joint.kind == "floating" for joint in tags.joints.values())
    if not (floats or tags.added_links or tags.added_joints):
        return whole
    return _assemble(whole, tags, warnings)


def _unfold_planar(tags: gazebo_tags.GazeboTags) -> None:
    """Replace each planar joint <name> by three joints.

    These are two prismatic joints in the plane, <name>_x and <name>_y, whose children are massless
    links, and a continuous joint about the normal of the plane.

    Raises:
        DescriptionError: a joint or link with such a name already exists.
    """
    joints: dict[str, Joint] = {}
    for joint in tags.joints.values():
        if joint.kind != "planar":
            joints[joint.name] = joint
            continue
        tilt, parent, at = quaternion_from_z_to(joint.axis), joint.parent, joint.pose
        for side, along in (("x", (1.0, 0.0, 0.0)), ("y", (0.0, 1.0, 0.0))):
            name = f"{joint.name}_{side}"
            if name in tags.joints or name in tags.links:
                raise DescriptionError(f"joint '{joint.name}': the simulator adds a joint and a "
                                       f"link '{name}' for this joint; rename your joint or link "
                                       "of the same name")
            tags.links[name] = Link(name, None)
            tags.poses[name] = tags.poses[joint.child]
            limits = JointLimits(-NO_LIMIT, NO_LIMIT, NO_LIMIT, NO_LIMIT)
            joints[name] = Joint(name, "prismatic", parent, name, axis=rotate(tilt, along),
                                 limits=limits).with_pose(at)
            parent, at = name, Pose()
        joints[joint.name] = replace(joint, kind="continuous", parent=parent).with_pose(at)
    tags.joints = joints


def _assemble(whole: RobotDescription, tags: gazebo_tags.GazeboTags, warnings: list[str]
               ) -> RobotDescription:
    """Return the robot with the links and joints of its `<gazebo>` tags added.

    Floating joints are removed, so that their children become trees that move freely. If the root
    link then has no mass, visuals or joints, it is removed as well.
    """
    links, poses = {**whole.links, **tags.added_links}, tags.poses
    if WORLD not in links and any(one.joint.parent == WORLD for one in tags.added_joints):
        links, poses = {WORLD: Link(WORLD, None), **links}, {**poses, WORLD: Pose()}
    placed = [JointInModel(joint, poses[joint.child]) for joint in whole.joints.values()
              if joint.kind != "floating"]
    where = f"robot '{safe_xml.shorten(whole.name)}'"
    trees = assemble(links, poses, [*placed, *tags.added_joints], whole.static, where)
    first = trees[0]
    if len(trees) > 1 and first.links == {first.root: Link(first.root, None)}:
        trees = trees[1:]
    at = poses[trees[0].root]
    return split_model(
        replace(whole, initial_pose=(at.xyz, at.rpy)), trees, poses, where, warnings, at
    )


def _read_link(name: str, element: Element, resolve: Resolve, warnings: list[str]) -> Link:
    where = f"link '{name}'"
    inertial = None
    node = element.find("inertial")
    if node is not None:
        xyz, rpy = read_origin(node, f"{where}: inertial")
        mass = node.find("mass")
        if mass is None:
            raise DescriptionError(f"{where}: <inertial> has no <mass>")
        tensor = node.find("inertia")
        values = tuple(
            parse_number(
                None if tensor is None else tensor.get(key), f"{where}: inertia {key}", 0.0
            )
            for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        )
        inertial = make_inertial(
            where,
            parse_number(mass.get("value"), f"{where}: mass value"),
            xyz,
            rpy,
            values,
            warnings,
        )
    visuals, collisions = [], []
    for i, node in enumerate(element.findall("visual")):
        inside = f"{where}, visual {i + 1}"
        shape = read_geometry(node, inside, resolve, warnings, False)
        if shape is not None:
            visuals.append(Visual(node.get("name") or "", *read_origin(node, inside), shape))
    for i, node in enumerate(element.findall("collision")):
        inside = f"{where}, collision {i + 1}"
        label = node.get("name") or (f"{name}_collision" + (f"_{i}" if i else ""))
        shape = read_geometry(node, inside, resolve, warnings, False)
        if shape is not None:
            collisions.append(Collision(label, *read_origin(node, inside), shape))
    return Link(name, inertial, tuple(visuals), tuple(collisions))


def _read_transmission(element: Element) -> Transmission:
    """Read a `<transmission>` without checking it.

    RobotHardware reports missing elements, as Gazebo does.
    """
    name = element.get("name") or ""
    joints, interfaces = [], []
    for node in element.findall("joint"):
        joints.append(node.get("name") or "")
        interfaces += [(n.text or "").strip() for n in node.findall("hardwareInterface")]
    kind = safe_xml.find_text(element, "type") or element.get("type") or ""
    return Transmission(
        name, kind, joints[0] if joints else "", interfaces[0] if interfaces else "",
        bool(element.findall("actuator")), tuple(joints), tuple(interfaces),
    )


def _compute_link_poses(tree: UrdfTree) -> dict[str, Pose]:
    """Return the poses of the links in the root's frame if all joints are at 0."""
    below: dict[str, list[Joint]] = {}
    for joint in tree.joints.values():
        below.setdefault(joint.parent, []).append(joint)
    poses = {tree.root: Pose()}
    pending = [tree.root]
    for link in pending:
        for joint in below.get(link, ()):
            poses[joint.child] = poses[link] @ joint.pose
            pending.append(joint.child)
    return poses
