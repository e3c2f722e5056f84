"""Readers of motion and force sensors in URDF and SDF, and of the plug-ins of these sensors."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from xml.etree.ElementTree import Element

from aras_sim_bridge.description import camera_tags, plugins
from aras_sim_bridge.description.camera_types import CameraDescription
from aras_sim_bridge.description.types import ChannelNoise, Link, SensorDescription
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.safe_xml import (
    ElementReader,
    find_text,
    parse_number,
    parse_numbers,
    shorten,
)
from aras_visual_servo_base.urdf import CAMERA_KINDS, Joint

WORLDS = ("world", "/world", "map", "/map")
_CHANNELS = {
    "imu": ("angular_velocity", "linear_acceleration"),
    "force_torque": ("force", "torque"),
}


class ModelSensors:
    """Cameras and sensors of a model, which are collected while its elements are read.

    Attributes:
        cameras: cameras of the links.
        sensors: IMUs of the links. `check` adds the other sensors.
    """

    def __init__(self, warnings: list[str]) -> None:
        """Create an empty collection; problems that are found are added to `warnings`."""
        self._warnings = warnings
        self.cameras: list[CameraDescription] = []
        self.sensors: list[SensorDescription] = []
        self._plugin_sensors: list[SensorDescription] = []
        # the force/torque <sensor> of each joint that has one
        self._force_torque_tags: dict[str, Element] = {}

    def add_plugins(self, read: Sequence[plugins.Plugin]) -> None:
        """Add the sensors among the plug-ins of a model."""
        self._plugin_sensors += [one for one in read if isinstance(one, SensorDescription)]

    def read_link(self, element: Element, link: str) -> None:
        """Read the `<sensor>` elements of a link.

        Raises:
            DescriptionError: an element is not a number, or a rate or noise is negative.
        """
        for sensor in element.findall("sensor"):
            kind = sensor.get("type") or ""
            if kind in CAMERA_KINDS:
                self.cameras += camera_tags.read_cameras(sensor, link, self._warnings)
            elif kind == "imu":
                self.sensors += _read_imus(sensor, link, self._warnings)
            elif kind == "contact":
                self._plugin_sensors += _read_bumpers(sensor, link, self._warnings)
            else:
                self._warnings.append(f"link '{link}': a sensor is ignored, because its type "
                                      f"'{shorten(kind)}' is not supported")

    def read_joint(self, element: Element, joint: str) -> None:
        """Read the plug-ins in the force/torque `<sensor>`s of a joint; they need no <jointName>.
        """
        for sensor in element.findall("sensor"):
            kind = sensor.get("type") or ""
            if kind != "force_torque":
                self._warnings.append(f"joint '{joint}': a sensor is ignored, because its type "
                                      f"'{shorten(kind)}' is not supported on a joint")
                continue
            self._force_torque_tags[joint] = sensor
            where = _describe_place(sensor, f"joint '{joint}'")
            for made in plugins.read(sensor, where, (SensorDescription,), self._warnings):
                self._plugin_sensors.append(replace(made, joint=made.joint or joint))

    def add_plugin_sensors(self, links: Mapping[str, Link], joints: Mapping[str, Joint]) -> None:
        """Add those sensors of the plug-ins to `sensors` that can measure something.

        Raises:
            DescriptionError: an element of a force/torque `<sensor>` is not a number.
        """
        moving = {name for name, joint in joints.items() if joint.is_movable}
        for made in self._plugin_sensors:
            self._warnings += (
                f"plug-in of a {made.kind} sensor: joint '{shorten(name)}' is ignored, because "
                "it does not exist or does not move" for name in made.joints if name not in moving)
            made = replace(made, joints=tuple(name for name in made.joints if name in moving))
            problem = _find_problem(made, links, joints)
            self._warnings += _find_missing_collisions(made, links)
            if problem:
                self._warnings.append(f"plug-in of a {made.kind} sensor is ignored: {problem}")
                continue
            if made.kind == "wrench":
                child, frame_link = joints[made.joint].child, f"{made.joint}_frame"
                # The joint's child may be a massless link that kinematic_tree.py inserted; its own
                # child is the real link.
                if child == frame_link and frame_link in joints:
                    child = joints[frame_link].child
                made = replace(made, link=child)
                if made.joint in self._force_torque_tags:
                    tag = self._force_torque_tags[made.joint]
                    made = _apply_force_torque_tag(made, tag, self._warnings)
            self.sensors.append(made)


def _read_imus(sensor: Element, link: str, warnings: list[str]) -> list[SensorDescription]:
    """Read the plug-ins of an IMU's `<sensor>` on `link`.

    Raises:
        DescriptionError: an element is not a number, or a rate or noise is negative.
    """
    where = _describe_place(sensor, f"link '{link}'")
    at = parse_numbers(find_text(sensor, "pose"), 6, f"{where}: pose", (0.0,) * 6)
    rate = _read_rate(sensor, where)
    found = []
    for made in plugins.read(sensor, where, (SensorDescription,), warnings):
        if made.kind != "imu":
            warnings.append(f"{where}: this plug-in is ignored, because it must be in <gazebo> or "
                            "<model>; move it there")
        elif not made.frame:
            warnings.append(f"{where}: a plug-in is ignored, because <frameName> is missing; add "
                            "it")
        else:
            found.append(replace(made, link=link, pose=(at[:3], at[3:]), sample_rate=rate,
                                 channels=_read_channels(sensor, "imu", where)))
    return found


def _read_bumpers(sensor: Element, link: str, warnings: list[str]) -> list[SensorDescription]:
    """Read the plug-ins and collision names of a contact `<sensor>` on `link`."""
    where = _describe_place(sensor, f"link '{link}'")
    names = tuple((node.text or node.get("name") or "").strip()
                  for node in sensor.findall("contact/collision"))
    return [replace(made, link=link, rate=_read_rate(sensor, where), collisions=names)
            for made in plugins.read(sensor, where, (SensorDescription,), warnings)]


def _read_rate(sensor: Element, where: str) -> float:
    rate = parse_number(find_text(sensor, "update_rate") or sensor.get("update_rate"),
                  f"{where}: update_rate", 0.0)
    if rate < 0.0:
        raise DescriptionError(f"{where}: update_rate is {rate} Hz; it must not be negative")
    return rate


def _describe_place(sensor: Element, owner: str) -> str:
    return f"sensor '{shorten(sensor.get('name') or '')}' on {owner}"


def _find_problem(
    description: SensorDescription, links: Mapping[str, Link], joints: Mapping[str, Joint]
) -> str:
    """Return the reason why a sensor cannot measure anything; '' if it can."""
    if description.kind == "imu":
        return "it must be inside <sensor type='imu'>; move it there"
    if not description.topic:
        return "<topicName> is missing; add it"
    if description.kind == "joint_states":
        return "" if description.joints else "no <jointName> is a joint that moves; correct it"
    if description.kind == "contact":
        return "" if description.collisions else (
            "it names no <collision> in a <contact>, or is not in a <sensor type='contact'>")
    if description.kind == "wrench":
        return (
            ""
            if description.joint in joints
            else f"joint '{shorten(description.joint)}' does not exist"
        )
    if description.link not in links:
        return f"link '{shorten(description.link)}' does not exist"
    if description.kind == "pose" and description.frame not in (*WORLDS, *links):
        return f"frame '{shorten(description.frame)}' is neither the world nor a link"
    return ""


def _find_missing_collisions(
    description: SensorDescription, links: Mapping[str, Link]
) -> list[str]:
    """Return a sentence for each missing collision that a contact sensor names.

    As in Gazebo, a sensor with missing collisions still publishes on its topic.
    """
    known = [one.name for link in links.values() for one in link.collisions]
    return [
        f"plug-in of a contact sensor: collision '{shorten(name)}' does not exist, so the sensor "
        f"reports no contacts of this collision; {suggest(name, known)}"
        for name in description.collisions
        if not any(is_same_collision(name, one) for one in known)
    ]


def is_same_collision(name: str, collision: str) -> bool:
    """Return whether `name` in a contact sensor refers to `collision`.

    When Gazebo merges a fixed link into its parent, it puts the parent's name before the
    collision's name. It also appends "_collision" to the names of URDF collisions.
    """
    collision_name = name.rpartition("_fixed_joint_lump__")[2]
    return collision_name in (collision, f"{collision}_collision")


def _apply_force_torque_tag(
    description: SensorDescription, sensor: Element, warnings: list[str]
) -> SensorDescription:
    where = _describe_place(sensor, f"joint '{description.joint}'")
    node = sensor.find("force_torque")
    options = {"frame": ("child", "parent", "sensor"),
             "measure_direction": ("child_to_parent", "parent_to_child")}
    chosen = {}
    for tag, known in options.items():
        chosen[tag] = find_text(node, tag) or known[0]
        if chosen[tag] not in known:
            warnings.append(f"{where}: {tag} '{shorten(chosen[tag])}' is unknown; {known[0]} is "
                            "used")
            chosen[tag] = known[0]
    at = parse_numbers(find_text(sensor, "pose"), 6, f"{where}: pose", (0.0,) * 6)
    return replace(
        description, pose=(at[:3], at[3:]), wrench_frame=chosen["frame"],
        on_child=chosen["measure_direction"] == "parent_to_child",
        channels=_read_channels(sensor, "force_torque", where))


def _read_channels(sensor: Element, kind: str, where: str) -> tuple[ChannelNoise, ...]:
    """Read the noise of the two vectors that an IMU or a force/torque sensor measures.

    Return one ChannelNoise for each of the six components, or () if all noise is zero.
    """
    found = []
    for quantity in _CHANNELS[kind]:
        for axis in "xyz":
            noise = ElementReader(sensor.find(f"{kind}/{quantity}/{axis}/noise"),
                                  f"{where}: {quantity} {axis} ")
            one = ChannelNoise(*(noise.read_number(tag, 0.0)
                                 for tag in ("mean", "stddev", "bias_mean", "bias_stddev")))
            if one.stddev < 0.0 or one.bias_stddev < 0.0:
                raise DescriptionError(f"{noise.prefix}has stddev {one.stddev:g} and bias_stddev "
                                       f"{one.bias_stddev:g}; they must not be negative")
            found.append(one)
    return tuple(found) if any(one != ChannelNoise() for one in found) else ()
