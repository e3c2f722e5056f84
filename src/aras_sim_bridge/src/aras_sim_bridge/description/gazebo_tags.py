"""Reader of the <gazebo> tags of a URDF: plug-ins, sensors, materials, link and joint settings."""

import copy
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from xml.etree.ElementTree import Element

from aras_sim_bridge.description import (
    gazebo_materials,
    grasp_tags,
    plugins,
    sensor_tags,
    supported_elements,
)
from aras_sim_bridge.description.camera_types import CameraDescription
from aras_sim_bridge.description.geometry_tags import Resolve, parse_friction, read_bounce
from aras_sim_bridge.description.kinematic_tree import JointInModel, find_links_between
from aras_sim_bridge.description.sdf_dialects import unify
from aras_sim_bridge.description.types import (
    ControlPlugin,
    GraspFixPlugin,
    Link,
    Rgba,
    SensorDescription,
)
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base.poses import Pose
from aras_visual_servo_base.safe_xml import (
    check_names,
    find_text,
    parse_bool,
    parse_number,
    shorten,
)
from aras_visual_servo_base.urdf import Joint


@dataclass
class GazeboTags:
    """Result of `parse`: everything that the <gazebo> tags of a model describe.

    Attributes:
        links, joints: links and joints of the URDF, with the settings of the tags.
        added_links, added_joints: links and joints that the tags add.
        poses: poses of all links in the model.
    """

    links: dict[str, Link]
    joints: dict[str, Joint]
    control_plugins: tuple[ControlPlugin, ...] = ()
    cameras: tuple[CameraDescription, ...] = ()
    sensors: tuple[SensorDescription, ...] = ()
    grasps: tuple[GraspFixPlugin, ...] = ()
    colours: dict[str, Rgba] = field(default_factory=dict)
    static: bool = False
    added_links: dict[str, Link] = field(default_factory=dict)
    poses: dict[str, Pose] = field(default_factory=dict)
    added_joints: list[JointInModel] = field(default_factory=list)


def parse(root: Element, links: Mapping[str, Link], joints: Mapping[str, Joint],
          poses: Mapping[str, Pose], resolve: Resolve, warnings: list[str]) -> GazeboTags:
    """Read every `<gazebo>` below `root`.

    Each unknown reference, plug-in or sensor and each unsupported element causes a warning.

    Args:
        poses: poses of the links in the model, with all joints at 0.
        resolve: function that returns the path of a mesh file.

    Raises:
        DescriptionError: a supported tag has an invalid value.
    """
    tags = GazeboTags(dict(links), dict(joints), poses=dict(poses))
    found: list[plugins.Plugin] = []
    sensors = sensor_tags.ModelSensors(warnings)
    ignored: list[tuple[str, str]] = []
    blocks = [_unify(block, warnings) for block in root.findall("gazebo")]
    for block in blocks:
        reference = block.get("reference")
        where = f"<gazebo reference='{shorten(reference)}'>" if reference else "<gazebo>"
        if reference is None:
            tags.static = parse_bool(find_text(block, "static"), "<gazebo>: static", tags.static)
            block_plugins = plugins.read(
                block, "<gazebo>", (ControlPlugin, SensorDescription, GraspFixPlugin), warnings,
                [joint.name for joint in joints.values() if joint.mimic is not None])
            found += block_plugins
            sensors.add_plugins(block_plugins)
            ignored += supported_elements.find_ignored_elements(block, "gazebo", where)
            for node in block.findall("link"):
                try:
                    _add_link(node, tags, resolve, warnings)
                except DescriptionError as error:
                    warnings.append(f"{error}; the link is ignored")
                    continue
                sensors.read_link(node, node.get("name"))
        elif reference in links:
            _read_link_flags(block, reference, tags, warnings)
            sensors.read_link(block, reference)
            ignored += supported_elements.find_ignored_elements(block, "gazebo link", where)
        elif reference in joints:
            _read_joint_settings(block, reference, tags, warnings)
            sensors.read_joint(block, reference)
            ignored += supported_elements.find_ignored_elements(block, "gazebo joint", where)
        else:
            warnings.append(f"{where} is ignored, because it names no link or joint; correct the "
                            "name")
    for node in (node for block in blocks if block.get("reference") is None
                 for node in block.findall("joint")):
        from aras_sim_bridge.description.sdf_joints import read_joints

        try:
            found_joints = read_joints(node, "<gazebo>", tags.poses)
            check_names([*joints, *(one.joint.name for one in tags.added_joints),
                         *(one.joint.name for one in found_joints)], "joints")
            between, between_poses = find_links_between(
                found_joints, {**tags.links, **tags.added_links}, "<gazebo>")
        except DescriptionError as error:
            warnings.append(f"{error}; the joint is ignored")
            continue
        tags.added_joints += found_joints
        tags.added_links |= between
        tags.poses |= between_poses
        sensors.read_joint(node, node.get("name"))
    warnings += supported_elements.format_sentences(dict.fromkeys(ignored))
    tags.cameras = tuple(_drop_duplicates(sensors.cameras, warnings))
    tags.control_plugins = tuple(one for one in found if isinstance(one, ControlPlugin))
    added = {one.joint.name: one.joint for one in tags.added_joints}
    sensors.add_plugin_sensors({**tags.links, **tags.added_links}, {**joints, **added})
    tags.sensors = tuple(sensors.sensors)
    tags.grasps = tuple(grasp_tags.check_grasps(
        [one for one in found if isinstance(one, GraspFixPlugin)], tags.links, warnings))
    return tags


def _unify(block: Element, warnings: list[str]) -> Element:
    """Return a copy of a <gazebo> block, converted to the newest version of SDF."""
    block = copy.deepcopy(block)
    for node in block:
        if node.tag in ("link", "joint", "sensor", "collision"):
            unify(node, warnings)
    return block


def _add_link(node: Element, tags: GazeboTags, resolve: Resolve, warnings: list[str]) -> None:
    from aras_sim_bridge.description.sdf_model import read_link
    from aras_sim_bridge.description.sdf_poses import read_pose

    link = read_link(node, "<gazebo>", resolve, [None] * len(node.findall("visual")), warnings)
    if link.name in {**tags.links, **tags.added_links}:
        raise DescriptionError(f"<gazebo>: two links are named '{link.name}'; rename one")
    tags.added_links[link.name] = link
    tags.poses[link.name] = read_pose(node, f"<gazebo>: link '{link.name}'")
    _set_colour(node, link.name, tags, warnings)


def _set_colour(node: Element, link: str, tags: GazeboTags, warnings: list[str]) -> None:
    """Set the colour of a link from the SDF visuals in `node`."""
    no_appearances = [None] * len(node.findall("visual"))
    colour = gazebo_materials.find_sdf_colour(node, link, warnings, no_appearances)
    if colour is not None:
        tags.colours[link] = colour


def _read_joint_settings(block: Element, name: str, tags: GazeboTags, warnings: list[str]) -> None:
    where = f"<gazebo reference='{name}'>"
    joint = tags.joints[name]
    stiffness = parse_number(_read_setting(block, "springStiffness"), f"{where}: springStiffness",
                       joint.stiffness)
    rest = parse_number(
        _read_setting(block, "springReference"), f"{where}: springReference", joint.rest
    )
    if stiffness < 0.0:
        raise DescriptionError(f"{where}: springStiffness is {stiffness}; it must not be negative")
    if stiffness and not joint.is_movable:
        warnings.append(f"{where}: springStiffness is ignored, because joint '{name}' is "
                        f"{joint.kind}; remove it")
        return
    tags.joints[name] = replace(joint, stiffness=stiffness, rest=rest)


def _drop_duplicates(
    cameras: list[CameraDescription], warnings: list[str]
) -> list[CameraDescription]:
    """Return the first camera of each name; warn about each of the other cameras.

    Names must be unique because the settings of a camera refer to it by its name.
    """
    unique_cameras: dict[str, CameraDescription] = {}
    for camera in cameras:
        if camera.name in unique_cameras:
            warnings.append(f"two cameras are named '{camera.name}'; the later one, on link "
                            f"'{camera.link}', is ignored: rename it")
        else:
            unique_cameras[camera.name] = camera
    return list(unique_cameras.values())


def _read_setting(block: Element, tag: str) -> str | None:
    """Return the text of the child element `tag`.

    In old URDF files, the attribute `value` of the child contains the text.
    """
    child = block.find(tag)
    if child is not None and child.get("value") is not None:
        return child.get("value")
    return find_text(block, tag)


def _read_link_flags(block: Element, name: str, tags: GazeboTags, warnings: list[str]) -> None:
    where = f"<gazebo reference='{name}'>"
    link = tags.links[name]
    _set_colour(block, name, tags, warnings)
    material = _read_setting(block, "material")
    if material:
        tags.colours[name] = gazebo_materials.find_colour(material, name, warnings)
    gravity = parse_bool(_read_setting(block, "gravity"), f"{where}: gravity", link.gravity)
    if parse_bool(_read_setting(block, "turnGravityOff"), f"{where}: turnGravityOff", False):
        gravity = False
    mu = _read_setting(block, "mu1")
    friction = link.mu if mu is None else parse_friction(mu, f"{where}: mu1")
    tags.links[name] = replace(
        link,
        gravity=gravity,
        mu=friction,
        # As in Gazebo, the first <bounce> of a <collision> in the block applies to all collisions
        # of the link.
        bounce=next(
            filter(None, (read_bounce(one, where) for one in block.findall("collision"))),
            link.bounce,
        ),
        kinematic=parse_bool(
            _read_setting(block, "kinematic"), f"{where}: kinematic", link.kinematic
        ),
    )
