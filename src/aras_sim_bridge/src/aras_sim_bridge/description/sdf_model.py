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
from aras_sim_bridge.description.assembly import WORLD, PlacedJoint, Tree, assemble
from aras_sim_bridge.description.geometry import Resolve, bounce, sdf_geometry
from aras_sim_bridge.description.inertia import checked_inertial
from aras_sim_bridge.description.ogre_materials import Locate, Look
from aras_sim_bridge.description.sdf_dialects import MODEL_FRAME
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
from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.poses import IDENTITY, Pose, Vector3
from aras_visual_servo_base.safe_xml import direction, number, shorten, text_of, truth
from aras_visual_servo_base.urdf import Joint, JointLimits

_TEXTURED = ("box", "plane", "mesh")
JOINT_KINDS = ("revolute", "continuous", "prismatic", "fixed")
_ENDLESS = 1e16  # SDF's way to say that a joint has no limit
_HERE = MappingProxyType({"world": Pose(), MODEL_FRAME: Pose()})


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
        one = read_joint(node, where, poses)
        if one.joint.kind == "revolute":
            low, high = one.joint.stops
            warnings += degrees_in_limits(low, high, f"{where}, joint '{one.joint.name}'")
        joints.append(one)
        for sensor in node.findall("sensor[@type='force_torque']"):
            gauges[one.joint.name] = sensor
            asked += sensor_tags.gauge(sensor, one.joint.name, warnings)
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


def name_of(element: Element, where: str) -> str:
    """The name that an element needs to have."""
    name = element.get("name")
    if not name or len(name) > 256:
        raise DescriptionError(f"{where}: a <{element.tag}> needs a name of 1 to 256 characters")
    return name


def pose_of(element: Element, where: str, frames: Mapping[str, Pose] = _HERE) -> Pose:
    """The pose of an element; frames: those by which it may be given, in that of the element
    around it."""
    node = element.find("pose")
    if node is None:
        return Pose()
    frame = node.get("relative_to") or node.get("frame") or "world"
    if frame not in frames:
        raise DescriptionError(
            f"{where}: <pose relative_to='{shorten(frame)}'> is not supported; give it in the "
            "frame of the element around it"
        )
    return frames[frame] @ safe_xml.pose(text_of(element, "pose"), f"{where}: pose")


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


def read_joint(element: Element, model: str, poses: Mapping[str, Pose]) -> PlacedJoint:
    """Read a `<joint>` between links that stand at `poses` in the model, or the world and one."""
    name = name_of(element, model)
    where = f"{model}, joint '{name}'"
    kind = element.get("type") or ""
    if kind not in JOINT_KINDS:
        raise DescriptionError(f"{where}: joint type '{shorten(kind)}' is not supported; use "
                               f"{', '.join(JOINT_KINDS)}")
    parent, child = text_of(element, "parent") or "", text_of(element, "child") or ""
    for end, known in ((parent, {*poses, WORLD}), (child, poses)):
        if end not in known:
            raise DescriptionError(f"{where}: link '{shorten(end)}' does not exist")
    own = pose_of(element, where)
    pose = poses[child] if own == Pose() else poses[child] @ own
    axis = element.find("axis")
    if kind == "fixed":
        return PlacedJoint(Joint(name, kind, parent, child), pose)
    along = direction(text_of(axis, "xyz"), f"{where}: axis", (0.0, 0.0, 1.0))
    frame = "" if axis is None or axis.find("xyz") is None else axis.find("xyz").get("expressed_in")
    if frame:
        known = {MODEL_FRAME: Pose(), WORLD: Pose(), **poses}
        if frame not in known:
            raise DescriptionError(f"{where}: <xyz expressed_in='{shorten(frame)}'> names no link; "
                                   "give the axis in the joint's frame")
        turn = Pose((0.0, 0.0, 0.0), (pose.inverse() @ known[frame]).quat)
        along = turn.apply(along)
    limit = None if axis is None else axis.find("limit")
    dynamics = None if axis is None else axis.find("dynamics")
    lower = _bound(limit, "lower", f"{where}: lower", -_ENDLESS)
    upper = _bound(limit, "upper", f"{where}: upper", _ENDLESS)
    if lower > upper:
        raise DescriptionError(f"{where}: lower {lower} is above upper {upper}")
    free = kind == "continuous" or kind == "revolute" and lower <= -1e15 and upper >= 1e15
    effort = _bound(limit, "effort", f"{where}: effort", _ENDLESS)
    velocity = _bound(limit, "velocity", f"{where}: velocity", _ENDLESS)
    limits = JointLimits(None if free else lower, None if free else upper,
                         effort if effort >= 0.0 else _ENDLESS,  # SDF: -1 is no limit
                         velocity if velocity >= 0.0 else _ENDLESS)
    damping = number(text_of(dynamics, "damping"), f"{where}: damping", 0.0)
    friction = number(text_of(dynamics, "friction"), f"{where}: friction", 0.0)
    if damping < 0.0 or friction < 0.0:
        raise DescriptionError(f"{where}: damping {damping} and friction {friction} must be ≥ 0")
    stiffness = number(text_of(dynamics, "spring_stiffness"), f"{where}: spring_stiffness", 0.0)
    if stiffness < 0.0:
        raise DescriptionError(f"{where}: spring_stiffness is {stiffness}; it must not be negative")
    rest = number(text_of(dynamics, "spring_reference"), f"{where}: spring_reference", 0.0)
    joint = Joint(name, "continuous" if free else kind, parent, child, axis=along, limits=limits,
                  damping=damping, friction=friction, stiffness=stiffness, rest=rest)
    cut = truth(text_of(element, "physics/simbody/must_be_loop_joint"), f"{where}: "
                "must_be_loop_joint", False)
    return PlacedJoint(joint, pose, cut)


def _bound(limit: Element | None, tag: str, where: str, default: float) -> float:
    """A limit; SDF's words for none are the default with its sign."""
    text = text_of(limit, tag)
    if text and text.lower().lstrip("+-") in ("inf", "infinity"):
        return -_ENDLESS if text.startswith("-") else _ENDLESS
    return number(text, where, default)


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
