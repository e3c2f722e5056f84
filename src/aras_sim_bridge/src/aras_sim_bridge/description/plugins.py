"""Readers of the supported Gazebo plug-ins, by file name; other plug-ins cause a warning."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import TypeVar
from xml.etree.ElementTree import Element

from aras_sim_bridge.description import supported_elements
from aras_sim_bridge.description.camera_types import CameraPlugin, DepthDescription
from aras_sim_bridge.description.types import (
    ControlPlugin,
    GraspFixPlugin,
    LinkAttacherPlugin,
    SensorDescription,
)
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base.safe_xml import ElementReader, find_text, shorten
from aras_visual_servo_base.urdf import ZERO

Plugin = ControlPlugin | CameraPlugin | SensorDescription | GraspFixPlugin | LinkAttacherPlugin
Kind = TypeVar("Kind", bound=Plugin)


def read(element: Element, where: str, kinds: tuple[type[Kind], ...], warnings: list[str],
         mimics: Collection[str] = ()) -> list[Kind]:
    """Read the plug-ins of `element` that have one of the types `kinds`.

    For other plug-ins, `warnings` gets one sentence for each file name.

    Args:
        where: name of the element in messages.
        mimics: names of the joints that have a `<mimic>`; used in the warning about a plug-in for
            mimic joints.

    Raises:
        DescriptionError: a supported plug-in has an invalid setting.
    """
    found = []
    for plugin in element.findall("plugin"):
        filename = shorten(plugin.get("filename") or "")
        name = filename.rpartition("/")[2].removeprefix("lib").removesuffix(".so")
        make = PLUGINS.get(name)
        made = None if make is None else make(ElementReader(plugin, f"{where}: "))
        if isinstance(made, kinds):
            found.append(made)
            warnings += supported_elements.describe_ignored_elements(
                plugin, f"plugin {name}", f"{where}: plugin '{filename}'"
            )
            continue
        problem = ("is ignored, because it is not known" if made is None
                   else "is ignored, because it does not belong here")
        if "mimic_joint" in filename:
            problem = _describe_mimic_plugin(plugin, mimics)
        warning = f"{where}: plugin '{filename}' {problem}"
        if warning not in warnings:
            warnings.append(warning)
    return found


def _describe_mimic_plugin(plugin: Element, mimics: Collection[str]) -> str:
    """Return the warning about a plug-in for mimic joints; such plug-ins are not supported."""
    joint, follower = find_text(plugin, "joint") or "", find_text(plugin, "mimicJoint") or ""
    if follower in mimics:
        return "is not needed: <mimic> already works"
    return (f"is not supported: give joint '{shorten(follower)}' a <mimic "
            f"joint='{shorten(joint)}'/>, which works")


def _read_control(plugin: ElementReader) -> ControlPlugin:
    plugin = ElementReader(plugin.element, "plugin gazebo_ros_control: ")
    period = None
    if plugin.read_text("controlPeriod") is not None:
        period = plugin.read_number("controlPeriod")
        if period <= 0.0:
            raise DescriptionError(
                f"{plugin.prefix}controlPeriod is {period} s; it must be positive"
            )
    return ControlPlugin(
        robot_namespace=plugin.read_text("robotNamespace"),
        control_period=period,
        e_stop_topic=plugin.read_text("eStopTopic"),
    )


def _read_camera(plugin: ElementReader) -> CameraPlugin:
    return CameraPlugin(
        robot_namespace=plugin.read_text("robotNamespace") or "",
        camera_name=plugin.read_text("cameraName") or "",
        image_topic=plugin.read_text("imageTopicName") or "image_raw",
        info_topic=plugin.read_text("cameraInfoTopicName") or "camera_info",
        frame_name=plugin.read_text("frameName") or "",
        update_rate=plugin.read_number("updateRate", 0.0),
        hack_baseline=plugin.read_number("hackBaseline", 0.0),
        cx=plugin.read_number("Cx", 0.0),
        cy=plugin.read_number("Cy", 0.0),
        focal_length=plugin.read_number("focalLength", 0.0),
        distortion=tuple(
            plugin.read_number(f"distortion{name}", 0.0) for name in ("K1", "K2", "K3", "T1", "T2")
        ),
        auto_distortion=plugin.read_bool("autoDistortion", False),
    )


def _read_triggered_camera(plugin: ElementReader) -> CameraPlugin:
    topic = plugin.read_text("triggerTopicName") or "image_trigger"
    return replace(_read_camera(plugin), trigger_topic=topic)


def _read_depth(plugin: ElementReader, depth: DepthDescription) -> CameraPlugin:
    """Read the plug-in of a depth camera; `depth` contains the defaults for this plug-in."""
    return replace(
        _read_camera(plugin),
        image_topic=plugin.read_text("imageTopicName") or "ir/image_raw",
        info_topic=plugin.read_text("cameraInfoTopicName") or "ir/camera_info",
        depth=replace(
            depth,
            nearest=plugin.read_number("pointCloudCutoff", 0.4),
            millimetres=plugin.read_bool("useDepth16UC1Format", False),
            image=plugin.read_text("depthImageTopicName") or depth.image,
            info=plugin.read_text("depthImageCameraInfoTopicName") or depth.info,
            points=plugin.read_text("pointCloudTopicName") or "points",
        ),
    )


def _read_depth_camera(plugin: ElementReader) -> CameraPlugin:
    return _read_depth(plugin, DepthDescription(rows=False))


def _read_kinect(plugin: ElementReader) -> CameraPlugin:
    farthest = plugin.read_number("pointCloudCutoffMax", 5.0)
    return _read_depth(plugin, DepthDescription(farthest=farthest))


def _read_sensor(plugin: ElementReader, kind: str, **settings: object) -> SensorDescription:
    """Read the settings that all motion and force sensor plug-ins have in common.

    `settings` replace those of the plug-in's elements.
    """
    made = SensorDescription(
        kind,
        plugin.read_text("topicName") or "",
        namespace=plugin.read_text("robotNamespace") or "",
        frame=plugin.read_text("frameName") or "",
        rate=plugin.read_number("updateRate", 0.0),
        noise=plugin.read_number("gaussianNoise", 0.0),
        offset=(plugin.read_numbers("xyzOffset", 3, ZERO),
                plugin.read_numbers("rpyOffset", 3, ZERO)),
        link=plugin.read_text("bodyName") or "",
    )
    made = replace(made, **settings)
    for name, value in (("noise", made.noise), ("rate", made.rate)):
        if value < 0.0:
            raise DescriptionError(f"{plugin.prefix}the {name} is {value}; it must not be negative")
    return made


def _read_pose_sensor(plugin: ElementReader) -> SensorDescription:
    return _read_sensor(plugin, "pose", frame=plugin.read_text("frameName") or "world")


def _read_body_imu(plugin: ElementReader) -> SensorDescription:
    topic = plugin.read_text("topicName")
    return _read_sensor(plugin, "body_imu", topic="/default_imu" if topic is None else topic)


def _read_imu(plugin: ElementReader) -> SensorDescription:
    return _read_sensor(
        plugin, "imu", topic=plugin.read_text("topicName") or "imu_data",
        namespace=plugin.read_text("robotNamespace"),
        rate=plugin.read_number("updateRateHZ", 1.0),
        from_start=plugin.read_bool("initialOrientationAsReference", False),
    )


def _read_wrench(plugin: ElementReader) -> SensorDescription:
    return _read_sensor(plugin, "wrench", joint=plugin.read_text("jointName") or "", frame="")


def _read_bumper(plugin: ElementReader) -> SensorDescription:
    return _read_sensor(plugin, "contact", noise=0.0, rate=0.0,
                        topic=plugin.read_text("bumperTopicName") or "bumper_states",
                        frame=plugin.read_text("frameName") or "world")


def _read_joint_states(plugin: ElementReader) -> SensorDescription:
    names = (name.strip() for name in (plugin.read_text("jointName") or "").split(","))
    return _read_sensor(
        plugin, "joint_states", topic="joint_states", frame="", noise=0.0,
        namespace=plugin.read_text("robotNamespace"),
        rate=plugin.read_number("updateRate", 100.0),
        joints=tuple(name for name in names if name))


def _read_grasp(plugin: ElementReader) -> GraspFixPlugin:
    # imported late, because few robots have this plug-in
    from aras_sim_bridge.description import grasp_tags

    return grasp_tags.read(plugin.element)


def _read_link_attacher(_plugin: ElementReader) -> LinkAttacherPlugin:
    return LinkAttacherPlugin()


PLUGINS: Mapping[str, Callable[[ElementReader], Plugin]] = MappingProxyType({
    "gazebo_ros_control": _read_control,
    "gazebo_ros_camera": _read_camera,
    "gazebo_ros_multicamera": _read_camera,
    "gazebo_ros_triggered_camera": _read_triggered_camera,
    "gazebo_ros_triggered_multicamera": _read_triggered_camera,
    "gazebo_ros_depth_camera": _read_depth_camera,
    "gazebo_ros_openni_kinect": _read_kinect,
    "gazebo_ros_p3d": _read_pose_sensor,
    "gazebo_ros_imu": _read_body_imu,
    "gazebo_ros_imu_sensor": _read_imu,
    "gazebo_ros_ft_sensor": _read_wrench,
    "gazebo_ros_bumper": _read_bumper,
    "gazebo_ros_joint_state_publisher": _read_joint_states,
    "gazebo_grasp_fix": _read_grasp,
    "gazebo_ros_link_attacher": _read_link_attacher,
})
