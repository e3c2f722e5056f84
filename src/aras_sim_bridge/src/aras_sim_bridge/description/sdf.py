"""SDF text -> models and lights.

Of SDF this takes what stands still or hangs on simple joints: boxes, cylinders, spheres, capsules,
planes and meshes, with colours, several links with fixed, revolute and prismatic joints, cameras,
and lights; includes, models in models, and a world's `<state>`. What is only looked at, or stands
beside the models, is left out with a warning that names it; a model that cannot be simulated as it
is written is refused by name.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import repeat
from types import MappingProxyType
from xml.etree.ElementTree import Element

from aras_sim_bridge.description import (
    gazebo_materials,
    grasp_tags,
    model_folders,
    ogre_materials,
    packages,
    plugins,
    population,
    sensor_tags,
    world_joints,
)
from aras_sim_bridge.description.geometry import Resolve, bounce, sdf_geometry
from aras_sim_bridge.description.inertia import checked_inertial
from aras_sim_bridge.description.lights import read_light
from aras_sim_bridge.description.ogre_materials import Locate, Look
from aras_sim_bridge.description.types import (
    CameraDescription,
    Collision,
    GraspDescription,
    Light,
    Link,
    LinkAttacher,
    Rgba,
    RobotDescription,
    SensorDescription,
    Visual,
)
from aras_sim_bridge.description.world_state import WorldState
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.poses import Pose, Vector3
from aras_visual_servo_base.safe_xml import (
    check_names,
    direction,
    number,
    shorten,
    text_of,
    truth,
)
from aras_visual_servo_base.urdf import Joint, JointLimits, root_link

_MODEL_TAGS = {"static", "pose", "link", "joint", "plugin", "self_collide", "allow_auto_disable",
               "enable_wind"}
_LINK_TAGS = {"pose", "inertial", "visual", "collision", "gravity", "kinematic", "sensor",
              "self_collide", "velocity_decay", "enable_wind", "must_be_base_link"}
_WORLD_TAGS = {"model", "light", "gravity", "physics", "scene", "plugin", "gui", "wind", "state",
               "frame", "atmosphere", "magnetic_field", "spherical_coordinates", "audio"}
# Nothing that is simulated depends on them.
_LEFT_OUT = {"actor", "road", "joint", "projector", "battery", "particle_emitter",
             "audio_source", "audio_sink", "gripper", "model_state"}
_TEXTURED = ("box", "plane", "mesh")
_JOINT_KINDS = ("revolute", "prismatic", "fixed")
_ENDLESS = 1e16  # SDF's way to say that a joint has no limit


@dataclass(frozen=True)
class SdfContent:
    """models: in file order. lights: in file order. warnings: what was passed over, a sentence
    each. time_ns: simulated time of a world's `<state>`. link_attacher: whether its plug-in is in
    the world."""

    models: tuple[RobotDescription, ...] = ()
    lights: tuple[Light, ...] = ()
    warnings: tuple[str, ...] = ()
    time_ns: int = 0
    link_attacher: bool = False


def parse_sdf(
    xml: str | Element,
    resolve_package: packages.ResolvePackage = packages.find,
    base_directory: str | None = None,
) -> RobotDescription:
    """The one model of an SDF text; arguments as `parse_urdf`'s.

    The model's own pose is in `initial_pose`; its root link's pose is worked into that link.

    Raises:
        DescriptionError: naming the element, what is wrong with it and how to mend it.
    """
    content = read_sdf(xml, resolve_package, base_directory)
    if len(content.models) != 1 or content.lights:
        left_out = "".join(f"; {warning}" for warning in content.warnings)
        raise DescriptionError(f"SDF: {len(content.models)} models and {len(content.lights)} "
                               f"lights; give one model at a time{left_out}")
    model = content.models[0]
    return replace(model, warnings=(*content.warnings, *model.warnings))


def read_sdf(
    xml: str | Element,
    resolve_package: packages.ResolvePackage = packages.find,
    base_directory: str | None = None,
) -> SdfContent:
    """All models and lights of an SDF text, a `<world>` around them or not.

    What a world includes comes from Gazebo's model folders (see model_folders.py), and where its
    `<state>` has models and lights is where they stand.

    Raises:
        DescriptionError: as `parse_sdf`.
    """
    root = safe_xml.parse(xml, "SDF")
    if root.tag not in ("sdf", "gazebo"):
        raise DescriptionError(f"SDF: the root element is <{shorten(root.tag)}>, not <sdf>")
    worlds = root.findall("world")
    if len(worlds) > 1:
        raise DescriptionError(f"SDF: {len(worlds)} worlds; one is simulated")
    scope = worlds[0] if worlds else root
    def resolve(uri: str, where: str) -> str:
        return packages.resolve_uri(uri, where, resolve_package, base_directory)

    def locate(uri: str, where: str) -> str:
        return packages.located(uri, where, resolve_package, base_directory, "material")

    models, lights = [], []
    warnings: list[str] = []
    link_attacher = bool(plugins.read(scope, "world", (LinkAttacher,), warnings))
    state = WorldState(scope.find("state"))
    inserted = Element("insertions")
    inserted.extend(state.insertions)
    elements = [*model_folders.expanded(scope, warnings, base_directory),
                *model_folders.expanded(inserted, warnings, base_directory)]
    elements = [one for element in elements for one in (
        population.members(element, warnings) if element.tag == "population" else (element,))]
    elements = world_joints.bolted(elements, warnings)
    _refuse_unknown(elements, _WORLD_TAGS, "SDF", warnings)
    frames = _frames(scope)
    for element in elements:
        if element.get("name") in state.deleted:
            continue
        if element.tag == "model":
            models.append(_model(element, resolve, locate, frames))
        elif element.tag == "light":
            where = f"light '{_name(element, 'SDF')}'"
            lights.append(read_light(element, _pose(element, where, frames)))
    models, lights = state.placed(models, lights, warnings)
    check_names([model.name for model in models], "models")
    check_names([light.name for light in lights], "lights")
    if not models and not lights and not worlds:
        raise DescriptionError("SDF: there is no <model> and no <light> in it")
    return SdfContent(tuple(models), tuple(lights), tuple(warnings), state.time_ns,
                      link_attacher)


def _refuse_unknown(elements: Iterable[Element], known: set[str], where: str,
                    warnings: list[str]) -> None:
    for child in elements:
        if child.tag in known or ":" in child.tag:
            continue
        if child.tag in _LEFT_OUT:
            name = f" '{shorten(child.get('name'))}'" if child.get("name") else ""
            warnings.append(f"{where}: <{child.tag}>{name} is not served; left out")
        else:
            raise DescriptionError(
                f"{where}: <{shorten(child.tag)}> is not supported; there may be "
                f"{', '.join(sorted(known))}"
            )


def _name(element: Element, where: str) -> str:
    name = element.get("name")
    if not name or len(name) > 256:
        raise DescriptionError(f"{where}: a <{element.tag}> needs a name of 1 to 256 characters")
    return name


_HERE = MappingProxyType({"world": Pose(), "__model__": Pose()})


def _pose(element: Element, where: str, frames: Mapping[str, Pose] = _HERE) -> Pose:
    """frames: those by which a pose may be given, in the frame of the element around it."""
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


def _frames(world: Element) -> Mapping[str, Pose]:
    """The `<frame>`s of a world, each in the world; one may stand on those before it."""
    frames = dict(_HERE)
    for node in world.findall("frame"):
        name = _name(node, "SDF")
        where = f"frame '{shorten(name)}'"
        on = node.get("attached_to") or "world"
        if on not in frames:
            raise DescriptionError(f"{where}: attached_to='{shorten(on)}' is no frame before it")
        frames[name] = frames[on] @ _pose(node, where, frames)
    return frames


def _model(element: Element, resolve: Resolve, locate: Locate, frames: Mapping[str, Pose]
           ) -> RobotDescription:
    name = _name(element, "SDF")
    where = f"model '{name}'"
    warnings: list[str] = []
    made = plugins.read(element, "SDF", (SensorDescription, GraspDescription), warnings)
    asked = [one for one in made if isinstance(one, SensorDescription)]
    _refuse_unknown(element, _MODEL_TAGS, where, warnings)
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
        link = _link(node, where, resolve, looks, warnings)
        if link.name in links:
            raise DescriptionError(f"{where}: two links are named '{link.name}'; rename one")
        links[link.name] = link
        poses[link.name] = _pose(node, f"{where}, link '{link.name}'")
        paint = gazebo_materials.sdf_colour(node, link.name, warnings, looks)
        if paint is not None:
            colours[link.name] = paint
        sensor_tags.of_link(node, link.name, cameras, sensors, asked, warnings)
    if not links:
        raise DescriptionError(f"{where}: has no <link>")
    joints: dict[str, Joint] = {}
    gauges: dict[str, Element] = {}
    for node in element.findall("joint"):
        joint = _joint(node, where, poses)
        if joint.name in joints:
            raise DescriptionError(f"{where}: two joints are named '{joint.name}'; rename one")
        at = _pose(node, f"{where}, joint '{joint.name}'")
        if joint.moves and at != Pose():
            # The joint moves a massless link that stands on it, and that one carries the child.
            own = f"{joint.name}_frame"
            links[own], poses[own] = Link(own, None), poses[joint.child] @ at
            joints[own] = Joint(own, "fixed", own, joint.child)
            joint = replace(joint, child=own)
        joints[joint.name] = joint
        for sensor in node.findall("sensor[@type='force_torque']"):
            gauges[joint.name] = sensor
            asked += sensor_tags.gauge(sensor, joint.name, warnings)
    if any(joint.parent == "world" for joint in joints.values()):
        links = {"world": Link("world", None), **links}
        poses["world"] = Pose()
    root, joints = _tree(where, links, joints, poses, static)
    links[root] = _shifted(links[root], poses[root])
    cameras, sensors = (
        [replace(one, pose=_moved(one.pose, poses[root])) if one.link == root else one
         for one in found] for found in (cameras, sensors))
    sensors += sensor_tags.of_model(asked, links, joints, gauges, warnings)
    pose = _pose(element, where, frames)
    return RobotDescription(
        name=name, root=root, links=MappingProxyType(links), joints=MappingProxyType(joints),
        cameras=tuple(cameras), sensors=tuple(sensors),
        grasps=tuple(grasp_tags.of_model(
            [one for one in made if isinstance(one, GraspDescription)], links, warnings)),
        colours=MappingProxyType(colours), static=static, warnings=tuple(warnings),
        initial_pose=(pose.xyz, pose.rpy),
    )


def _link(element: Element, model: str, resolve: Resolve, looks: Sequence[Look | None],
          warnings: list[str]) -> Link:
    name = _name(element, model)
    where = f"{model}, link '{name}'"
    _refuse_unknown(element, _LINK_TAGS, where, warnings)
    inertial = None
    node = element.find("inertial")
    mass = number(text_of(node, "mass"), f"{where}: mass", 1.0)  # SDF's defaults: 1 kg, unit tensor
    pose = Pose() if node is None else _pose(node, f"{where}: inertial")
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
            inside = f"{where}, {kind} '{shorten(_name(part, where))}'"
            at = _pose(part, inside)
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


def _joint(element: Element, model: str, poses: Mapping[str, Pose]) -> Joint:
    name = _name(element, model)
    where = f"{model}, joint '{name}'"
    kind = element.get("type") or ""
    if kind not in _JOINT_KINDS:
        raise DescriptionError(f"{where}: joint type '{shorten(kind)}' is not supported; use "
                               f"{', '.join(_JOINT_KINDS)}")
    parent, child = text_of(element, "parent") or "", text_of(element, "child") or ""
    for end, known in ((parent, {*poses, "world"}), (child, poses)):
        if end not in known:
            raise DescriptionError(f"{where}: link '{shorten(end)}' does not exist")
    axis = element.find("axis")
    if kind == "fixed":
        return Joint(name, kind, parent, child)
    if truth(text_of(axis, "use_parent_model_frame"), f"{where}: use_parent_model_frame", False):
        raise DescriptionError(f"{where}: <use_parent_model_frame> is not supported; give <xyz> in "
                               "the child link's frame")
    along = direction(text_of(axis, "xyz"), f"{where}: axis", (0.0, 0.0, 1.0))
    limit = None if axis is None else axis.find("limit")
    dynamics = None if axis is None else axis.find("dynamics")
    lower = number(text_of(limit, "lower"), f"{where}: lower", -_ENDLESS)
    upper = number(text_of(limit, "upper"), f"{where}: upper", _ENDLESS)
    if lower > upper:
        raise DescriptionError(f"{where}: lower {lower} is above upper {upper}")
    free = kind == "revolute" and lower <= -1e15 and upper >= 1e15
    effort = number(text_of(limit, "effort"), f"{where}: effort", _ENDLESS)
    velocity = number(text_of(limit, "velocity"), f"{where}: velocity", _ENDLESS)
    limits = JointLimits(None if free else lower, None if free else upper,
                         effort if effort >= 0.0 else _ENDLESS,  # SDF: -1 is no limit
                         velocity if velocity >= 0.0 else _ENDLESS)
    damping = number(text_of(dynamics, "damping"), f"{where}: damping", 0.0)
    friction = number(text_of(dynamics, "friction"), f"{where}: friction", 0.0)
    if damping < 0.0 or friction < 0.0:
        raise DescriptionError(f"{where}: damping {damping} and friction {friction} must be ≥ 0")
    return Joint(name, "continuous" if free else kind, parent, child,
                 axis=along, limits=limits, damping=damping,
                 friction=friction)


def _tree(where: str, links: dict[str, Link], joints: dict[str, Joint], poses: Mapping[str, Pose],
          static: bool) -> tuple[str, dict[str, Joint]]:
    """(root link, joints placed in their parents), from links placed in the model."""
    children = {joint.child for joint in joints.values()}
    roots = [name for name in links if name not in children]
    joined = dict(joints)
    for extra in roots[1:]:
        if not static:
            raise DescriptionError(
                f"{where}: links '{roots[0]}' and '{extra}' are not joined; make them models of "
                "their own, join them, or make the model static"
            )
        joined[f"{extra}_stands"] = Joint(f"{extra}_stands", "fixed", roots[0], extra)
    root = root_link(links, joined, where)
    placed = {}
    for name, joint in joined.items():
        # The root link's frame becomes the model's, so its children are placed in the model.
        parent = Pose() if joint.parent == root else poses[joint.parent]
        placed[name] = joint.at(parent.inverse() @ poses[joint.child])
    return root, placed


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
