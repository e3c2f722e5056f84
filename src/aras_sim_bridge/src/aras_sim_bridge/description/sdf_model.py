"""One `<model>` of SDF: its links, joints, sensors and looks."""

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
    served,
)
from aras_sim_bridge.description.assembly import (
    WORLD,
    PlacedJoint,
    Tree,
    assemble,
    links_between,
)
from aras_sim_bridge.description.geometry import Resolve, bounce, sdf_geometry
from aras_sim_bridge.description.inertia import checked_inertial
from aras_sim_bridge.description.ogre_materials import Locate, Look
from aras_sim_bridge.description.sdf_joints import read_joints
from aras_sim_bridge.description.sdf_poses import name_of, pose_of
from aras_sim_bridge.description.types import (
    CameraDescription,
    Collision,
    GraspDescription,
    Link,
    Rgba,
    RobotDescription,
    SensorDescription,
    Visual,
)
from aras_sim_bridge.description.units import degrees_in_limits
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base.poses import IDENTITY, Pose, Vector3
from aras_visual_servo_base.safe_xml import number, shorten, text_of, truth
from aras_visual_servo_base.urdf import Joint

_TEXTURED = ("box", "plane", "mesh")


def read_model(element: Element, resolve: Resolve, locate: Locate, frames: Mapping[str, Pose]
               ) -> RobotDescription:
    """Read a `<model>` without models in it.

    Args:
        element: as sdf_dialects.unify leaves it. resolve, locate: find meshes and materials.
        frames: those of the world, by which the model's pose may be given.

    Raises:
        DescriptionError: naming the element, what is wrong with it and how to fix it.
    """
    name = name_of(element, "SDF")
    where = f"model '{name}'"
    warnings: list[str] = []
    made = plugins.read(element, "SDF", (SensorDescription, GraspDescription), warnings)
    asked = [one for one in made if isinstance(one, SensorDescription)]
    warnings += served.unserved(element, "model", where)
    static = truth(text_of(element, "static"), f"{where}: static", False)
    links: dict[str, Link] = {}
    poses: dict[str, Pose] = {}
    colours: dict[str, Rgba] = {}
    cameras: list[CameraDescription] = []
    sensors: list[SensorDescription] = []
    for node in element.findall("link"):
        inside = f"{where}, link '{node.get('name')}'"
        looks = [ogre_materials.look(visual, inside, locate, warnings)
                 for visual in node.findall("visual")]
        link = read_link(node, where, resolve, looks, warnings)
        if link.name in links:
            raise DescriptionError(f"{where}: two links are named '{link.name}'; rename one")
        links[link.name] = link
        poses[link.name] = pose_of(node, f"{where}, link '{link.name}'")
        paint = gazebo_materials.sdf_colour(node, link.name, warnings, looks)
        if paint is not None:
            colours[link.name] = paint
        sensor_tags.of_link(node, link.name, cameras, sensors, asked, warnings)
    if not links:
        raise DescriptionError(f"{where}: has no <link>")
    joints: list[PlacedJoint] = []
    gauges: dict[str, Element] = {}
    for node in element.findall("joint"):
        found = read_joints(node, where, poses)
        for joint in (one.joint for one in found if one.joint.kind == "revolute"):
            warnings += degrees_in_limits(*joint.stops, f"{where}, joint '{joint.name}'")
        joints += found
        asked += sensor_tags.of_joint(node, found[0].joint.name, gauges, warnings)
    between, between_poses = links_between(joints, links, where)
    links |= between
    poses |= between_poses
    if any(one.joint.parent == WORLD for one in joints):
        links = {WORLD: Link(WORLD, None), **links}
        poses[WORLD] = Pose()
    trees = assemble(links, poses, joints, static, where)
    main = trees[0]
    main.links[main.root] = _shifted(main.links[main.root], poses[main.root])
    cameras, sensors = (
        [replace(one, pose=_moved(one.pose, poses[main.root])) if one.link == main.root else one
         for one in found] for found in (cameras, sensors))
    every = {joint.name: joint for tree in trees for joint in tree.joints.values()}
    sensors += sensor_tags.of_model(asked, links, every, gauges, warnings)
    pose = pose_of(element, where, frames)
    whole = RobotDescription(
        name=name, root=main.root, links={}, joints={}, cameras=tuple(cameras),
        sensors=tuple(sensors), colours=MappingProxyType(colours), static=static,
        grasps=tuple(grasp_tags.of_model(
            [one for one in made if isinstance(one, GraspDescription)], main.links, warnings)),
        initial_pose=(pose.xyz, pose.rpy))
    return divide(whole, trees, poses, where, warnings)


def divide(whole: RobotDescription, trees: Sequence[Tree], poses: Mapping[str, Pose], where: str,
           warnings: list[str], frame: Pose = IDENTITY) -> RobotDescription:
    """Return the description of the first tree with those of the others as its parts.

    Args:
        whole: what all trees have in common, and the cameras and sensors of all of them.
        poses: of the links in the model. frame: that of the first tree there.
    """
    def place(tree: Tree) -> tuple[Vector3, Vector3]:
        at = frame.inverse() @ poses[tree.root]
        return at.xyz, at.rpy

    def of(tree: Tree, parts: tuple[RobotDescription, ...]) -> RobotDescription:
        return replace(
            whole, root=tree.root, links=MappingProxyType(tree.links),
            joints=MappingProxyType(tree.joints),
            cameras=tuple(one for one in whole.cameras if one.link in tree.links),
            sensors=tuple(one for one in whole.sensors if _measures(one, tree)),
            loops=() if whole.static else tree.loops, parts=parts)

    for tree in () if whole.static else trees:
        warnings += (text for loop in tree.loops for text in _unserved_loop(loop.joint, where))
    parts = tuple(replace(
        of(tree, ()), control_plugins=(), transmissions=(), grasps=(), initial_pose=place(tree))
        for tree in trees[1:])
    lost = set(whole.sensors) - {one for tree in trees for one in whole.sensors
                                 if _measures(one, tree)}
    warnings += (f"{where}: the {one.kind} sensor of link '{one.link}' is left out: what it "
                 "measures is in two bodies that no joint holds together" for one in lost)
    return replace(of(trees[0], parts), warnings=tuple(warnings))


def _measures(sensor: SensorDescription, tree: Tree) -> bool:
    """Whether all that a sensor needs is in one tree."""
    if sensor.joint or sensor.joints:
        return {sensor.joint, *sensor.joints} - {""} <= set(tree.joints)
    framed = sensor.kind != "pose" or sensor.frame in (*sensor_tags.WORLDS, *tree.links)
    return sensor.link in tree.links and framed


def _unserved_loop(joint: Joint, where: str) -> list[str]:
    """What a joint that closes a chain has in vain: the constraint that holds it is free."""
    low, high = joint.stops
    found = {"limits": math.isfinite(low) or math.isfinite(high), "damping": joint.damping,
             "friction": joint.friction, "a spring": joint.stiffness}
    idle = [name for name, given in found.items() if given]
    return [f"{where}: joint '{joint.name}' closes a chain, where its {' and '.join(idle)} are not "
            "served; give them to another joint of the chain"] if idle else []


def read_link(element: Element, model: str, resolve: Resolve, looks: Sequence[Look | None],
              warnings: list[str]) -> Link:
    """Read a `<link>`; model: names its model in messages. looks: of its visuals, by scripts."""
    name = name_of(element, model)
    where = f"{model}, link '{name}'"
    inertial = None
    node = element.find("inertial")
    mass = number(text_of(node, "mass"), f"{where}: mass", 1.0)  # SDF's defaults: 1 kg, unit tensor
    pose = Pose() if node is None else pose_of(node, f"{where}: inertial")
    tensor = None if node is None else node.find("inertia")
    defaults = {"ixx": 1.0, "iyy": 1.0, "izz": 1.0}
    inertial = checked_inertial(
        where, mass, pose.xyz, pose.rpy,
        tuple(number(text_of(tensor, key), f"{where}: {key}", defaults.get(key, 0.0))
              for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")), warnings)
    visuals, collisions, mu, bounces = [], [], None, None
    for kind in ("visual", "collision"):
        paired = looks if kind == "visual" else repeat(None)
        for part, look in zip(element.findall(kind), paired, strict=False):
            inside = f"{where}, {kind} '{shorten(name_of(part, where))}'"
            at = pose_of(part, inside)
            shape = sdf_geometry(part, inside, resolve, warnings)
            if shape is None:
                continue
            if kind == "visual":
                texture = "" if look is None else look.texture
                if texture and shape.kind not in _TEXTURED:
                    warnings.append(f"{inside}: a texture is drawn on {', '.join(_TEXTURED)} only")
                    texture = ""
                visuals.append(Visual(part.get("name"), at.xyz, at.rpy, shape, texture))
            else:
                collisions.append(Collision(part.get("name"), at.xyz, at.rpy, shape))
                friction = part.find("surface/friction/ode")
                if text_of(friction, "mu") is not None:
                    mu = number(text_of(friction, "mu"), f"{inside}: mu")
                    if mu < 0.0:
                        raise DescriptionError(f"{inside}: mu is {mu}; it must not be negative")
                bounces = bounce(part, inside) or bounces
    return Link(name, inertial, tuple(visuals), tuple(collisions),
                truth(text_of(element, "gravity"), f"{where}: gravity", True),
                truth(text_of(element, "kinematic"), f"{where}: kinematic", False), mu, bounces)


def _shifted(link: Link, pose: Pose) -> Link:
    """The link in the model's frame instead of its own."""
    if pose == Pose():
        return link
    inertial = link.inertial
    return replace(
        link, inertial=None if inertial is None else inertial.at(pose @ inertial.pose),
        visuals=tuple(part.at(pose @ part.pose) for part in link.visuals),
        collisions=tuple(part.at(pose @ part.pose) for part in link.collisions))


def _moved(at: tuple[Vector3, Vector3], pose: Pose) -> tuple[Vector3, Vector3]:
    """xyz and rpy in the model's frame instead of the link's, which stands at `pose`."""
    placed = pose @ Pose.from_rpy(*at)
    return placed.xyz, placed.rpy
