"""Reader of one SDF `<model>`: its links, joints, sensors and appearance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import repeat
from types import MappingProxyType
from xml.etree.ElementTree import Element

from aras_sim_bridge.description import (
    gazebo_materials,
    grasp_tags,
    ogre_materials,
    plugins,
    sensor_tags,
    supported_elements,
)
from aras_sim_bridge.description.angle_unit_check import describe_limits_in_degrees
from aras_sim_bridge.description.geometry_tags import (
    Resolve,
    parse_friction,
    read_bounce,
    read_geometry,
)
from aras_sim_bridge.description.inertia import make_inertial
from aras_sim_bridge.description.kinematic_tree import (
    WORLD,
    JointInModel,
    KinematicTree,
    assemble,
    find_links_between,
)
from aras_sim_bridge.description.ogre_materials import Appearance, Locate
from aras_sim_bridge.description.sdf_joints import read_joints
from aras_sim_bridge.description.sdf_poses import read_name, read_pose
from aras_sim_bridge.description.types import (
    Collision,
    GraspFixPlugin,
    Link,
    Rgba,
    RobotDescription,
    SensorDescription,
    Visual,
)
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base.poses import IDENTITY, Pose, Vector3
from aras_visual_servo_base.safe_xml import (
    ElementReader,
    find_text,
    parse_bool,
    shorten,
)
from aras_visual_servo_base.urdf import Joint

_TEXTURE_SHAPES = ("box", "plane", "mesh")


def read_model(element: Element, resolve: Resolve, locate: Locate, frames: Mapping[str, Pose]
               ) -> RobotDescription:
    """Read a `<model>` without nested models.

    Args:
        element: element that `sdf_dialects.unify` has rewritten.
        resolve, locate: functions that return the paths of mesh files and material scripts.
        frames: frames of the world that the model's pose may refer to.

    Raises:
        DescriptionError: an element is invalid; the message names the element, the problem and how
            to fix it.
    """
    name = read_name(element, "SDF")
    where = f"model '{name}'"
    warnings: list[str] = []
    read_plugins = plugins.read(element, "SDF", (SensorDescription, GraspFixPlugin), warnings)
    sensors = sensor_tags.ModelSensors(warnings)
    sensors.add_plugins(read_plugins)
    warnings += supported_elements.describe_ignored_elements(element, "model", where)
    static = parse_bool(find_text(element, "static"), f"{where}: static", False)
    links: dict[str, Link] = {}
    poses: dict[str, Pose] = {}
    colours: dict[str, Rgba] = {}
    for node in element.findall("link"):
        inside = f"{where}, link '{node.get('name')}'"
        appearances = [ogre_materials.read_appearance(visual, inside, locate, warnings)
                 for visual in node.findall("visual")]
        link = read_link(node, where, resolve, appearances, warnings)
        if link.name in links:
            raise DescriptionError(f"{where}: two links are named '{link.name}'; rename one")
        links[link.name] = link
        poses[link.name] = read_pose(node, f"{where}, link '{link.name}'")
        colour = gazebo_materials.find_sdf_colour(node, link.name, warnings, appearances)
        if colour is not None:
            colours[link.name] = colour
        sensors.read_link(node, link.name)
    if not links:
        raise DescriptionError(f"{where}: <link> is missing; add one")
    joints: list[JointInModel] = []
    for node in element.findall("joint"):
        found = read_joints(node, where, poses)
        for joint in (one.joint for one in found if one.joint.kind == "revolute"):
            warnings += describe_limits_in_degrees(*joint.stops, f"{where}, joint '{joint.name}'")
        joints += found
        sensors.read_joint(node, found[0].joint.name)
    between, between_poses = find_links_between(joints, links, where)
    links |= between
    poses |= between_poses
    if any(one.joint.parent == WORLD for one in joints):
        links = {WORLD: Link(WORLD, None), **links}
        poses[WORLD] = Pose()
    trees = assemble(links, poses, joints, static, where)
    cut = between.keys() & {end for tree in trees for loop in tree.loops
                            for end in (loop.joint.parent, loop.joint.child)}
    if cut and not static:
        # Bullet cannot close a chain by a joint of several axes.
        for one in (one for one in joints if one.massless_link in cut):
            warnings.append(
                f"{where}: joint '{one.joint.name}' is ignored, because it closes a chain; close "
                "the chain by a revolute, prismatic or fixed joint")
        joints = [one for one in joints if not cut & {one.massless_link, one.joint.parent}]
        links = {name: link for name, link in links.items() if name not in cut}
        trees = assemble(links, poses, joints, static, where)
    main = trees[0]
    main.links[main.root] = _shift_link(main.links[main.root], poses[main.root])
    for found in (sensors.cameras, sensors.sensors):
        found[:] = [
            replace(one, pose=_transform_origin(one.pose, poses[main.root]))
            if one.link == main.root else one for one in found]
    every = {joint.name: joint for tree in trees for joint in tree.joints.values()}
    sensors.add_plugin_sensors(links, every)
    pose = read_pose(element, where, frames)
    whole = RobotDescription(
        name=name, root=main.root, links={}, joints={}, cameras=tuple(sensors.cameras),
        sensors=tuple(sensors.sensors), colours=MappingProxyType(colours), static=static,
        grasps=tuple(grasp_tags.check_grasps(
            [one for one in read_plugins if isinstance(one, GraspFixPlugin)],
            main.links, warnings)),
        initial_pose=(pose.xyz, pose.rpy))
    return split_model(whole, trees, poses, where, warnings)


def split_model(
    whole: RobotDescription,
    trees: Sequence[KinematicTree],
    poses: Mapping[str, Pose],
    where: str,
    warnings: list[str],
    frame: Pose = IDENTITY,
) -> RobotDescription:
    """Return the description of the first tree; its `parts` describe the other trees.

    Args:
        whole: description with the settings common to all trees, and the cameras and sensors of all
            trees.
        poses: poses of the links in the model.
        frame: pose of the first tree in the model.
    """
    def place_tree(tree: KinematicTree) -> tuple[Vector3, Vector3]:
        at = frame.inverse() @ poses[tree.root]
        return at.xyz, at.rpy

    def make_description(
        tree: KinematicTree, parts: tuple[RobotDescription, ...]
    ) -> RobotDescription:
        return replace(
            whole, root=tree.root, links=MappingProxyType(tree.links),
            joints=MappingProxyType(tree.joints),
            cameras=tuple(one for one in whole.cameras if one.link in tree.links),
            sensors=tuple(one for one in whole.sensors if _has_sensor_links(one, tree)),
            loops=() if whole.static else tree.loops, parts=parts)

    for tree in () if whole.static else trees:
        warnings += (
            text for loop in tree.loops for text in _describe_ignored_loop(loop.joint, where)
        )
    parts = tuple(
        replace(
            make_description(tree, ()),
            control_plugins=(),
            transmissions=(),
            grasps=(),
            initial_pose=place_tree(tree),
        )
        for tree in trees[1:]
    )
    split_sensors = set(whole.sensors) - {one for tree in trees for one in whole.sensors
                                 if _has_sensor_links(one, tree)}
    warnings += (f"{where}: the {one.kind} sensor of link '{one.link}' is ignored, because "
                 "its links or joints are in parts of the model that no joint connects; connect "
                 "them"
                 for one in split_sensors)
    return replace(make_description(trees[0], parts), warnings=tuple(warnings))


def _has_sensor_links(sensor: SensorDescription, tree: KinematicTree) -> bool:
    """Return whether all links and joints that a sensor needs are in one tree."""
    if sensor.joint or sensor.joints:
        return {sensor.joint, *sensor.joints} - {""} <= set(tree.joints)
    framed = sensor.kind != "pose" or sensor.frame in (*sensor_tags.WORLDS, *tree.links)
    return sensor.link in tree.links and framed


def _describe_ignored_loop(joint: Joint, where: str) -> list[str]:
    """Return a warning if a joint that closes a chain has limits, damping, friction or a spring.

    Bullet's constraint, which replaces such a joint, has none of these.
    """
    low, high = joint.stops
    found = {"limits": math.isfinite(low) or math.isfinite(high), "damping": joint.damping,
             "friction": joint.friction, "a spring": joint.stiffness}
    unsupported = [name for name, given in found.items() if given]
    return [f"{where}: joint '{joint.name}' closes a chain and cannot have "
            f"{' and '.join(unsupported)}; give them to another joint of the "
            "chain"] if unsupported else []


def read_link(
    element: Element,
    model: str,
    resolve: Resolve,
    appearances: Sequence[Appearance | None],
    warnings: list[str],
) -> Link:
    """Read a `<link>`.

    Args:
        model: name of the link's model in messages.
        appearances: for each visual of the link, the appearance from its material script.
    """
    name = read_name(element, model)
    where = f"{model}, link '{name}'"
    node = element.find("inertial")
    pose = Pose() if node is None else read_pose(node, f"{where}: inertial")
    # By SDF's defaults, a link has a mass of 1 kg and a unit inertia tensor.
    mass = ElementReader(node, f"{where}: ").read_number("mass", 1.0)
    tensor = ElementReader(element.find("inertial/inertia"), f"{where}: ")
    defaults = {"ixx": 1.0, "ixy": 0.0, "ixz": 0.0, "iyy": 1.0, "iyz": 0.0, "izz": 1.0}
    inertia = tuple(tensor.read_number(key, default) for key, default in defaults.items())
    inertial = make_inertial(where, mass, pose.xyz, pose.rpy, inertia, warnings)
    visuals, collisions, mu, bounces = [], [], None, None
    for kind in ("visual", "collision"):
        paired = appearances if kind == "visual" else repeat(None)
        for part, appearance in zip(element.findall(kind), paired, strict=False):
            inside = f"{where}, {kind} '{shorten(read_name(part, where))}'"
            at = read_pose(part, inside)
            shape = read_geometry(part, inside, resolve, warnings, True)
            if shape is None:
                continue
            if kind == "visual":
                texture = "" if appearance is None else appearance.texture
                if texture and shape.kind not in _TEXTURE_SHAPES:
                    warnings.append(
                        f"{inside}: the texture is ignored, because textures are only drawn on "
                        f"{', '.join(_TEXTURE_SHAPES)}"
                    )
                    texture = ""
                visuals.append(Visual(part.get("name"), at.xyz, at.rpy, shape, texture))
            else:
                collisions.append(Collision(part.get("name"), at.xyz, at.rpy, shape))
                friction = part.find("surface/friction/ode")
                if find_text(friction, "mu") is not None:
                    mu = parse_friction(find_text(friction, "mu"), f"{inside}: mu")
                bounces = read_bounce(part, inside) or bounces
    flags = ElementReader(element, f"{where}: ")
    return Link(name, inertial, tuple(visuals), tuple(collisions), flags.read_bool("gravity", True),
                flags.read_bool("kinematic", False), mu, bounces)


def _shift_link(link: Link, pose: Pose) -> Link:
    """Return a link whose elements are placed in the model's frame instead of the link's frame.

    `pose` is the pose of the link in the model.
    """
    if pose == Pose():
        return link
    inertial = link.inertial
    return replace(
        link, inertial=None if inertial is None else inertial.with_pose(pose @ inertial.pose),
        visuals=tuple(part.with_pose(pose @ part.pose) for part in link.visuals),
        collisions=tuple(part.with_pose(pose @ part.pose) for part in link.collisions))


def _transform_origin(at: tuple[Vector3, Vector3], pose: Pose) -> tuple[Vector3, Vector3]:
    """Convert an (xyz, rpy) pose in a link to the model's frame; `pose` is the link's."""
    placed = pose @ Pose.from_rpy(*at)
    return placed.xyz, placed.rpy
