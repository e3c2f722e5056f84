"""Readers of the supported Gazebo plug-ins, by file name; other plug-ins cause a warning."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import TypeVar
from xml.etree.ElementTree import Element

from aras_sim_bridge.description import supported_elements
from aras_sim_bridge.description.types import (
    CameraPlugin,
    ControlPlugin,
    DepthDescription,
    GraspFixPlugin,
    LinkAttacherPlugin,
    SensorDescription,
)
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base.poses import Vector3
from aras_visual_servo_base.safe_xml import (
    find_text,
    parse_bool,
    parse_number,
    parse_numbers,
    shorten,
)
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
        made = None if make is None else make(plugin, where)
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


def _read_control(plugin: Element, where: str) -> ControlPlugin:
    where = "plugin gazebo_ros_control"
    period = find_text(plugin, "controlPeriod")
    value = None if period is None else parse_number(period, f"{where}: controlPeriod")
    if value is not None and value <= 0.0:
        raise DescriptionError(f"{where}: controlPeriod is {value} s; it must be positive")
    return ControlPlugin(
        robot_namespace=find_text(plugin, "robotNamespace"),
        control_period=value,
        e_stop_topic=find_text(plugin, "eStopTopic"),
    )


def _read_camera(plugin: Element, where: str) -> CameraPlugin:
    def read_value(tag: str) -> float:
        return parse_number(find_text(plugin, tag), f"{where}: {tag}", 0.0)

    return CameraPlugin(
        robot_namespace=find_text(plugin, "robotNamespace") or "",
        camera_name=find_text(plugin, "cameraName") or "",
        image_topic=find_text(plugin, "imageTopicName") or "image_raw",
        info_topic=find_text(plugin, "cameraInfoTopicName") or "camera_info",
        frame_name=find_text(plugin, "frameName") or "",
        update_rate=read_value("updateRate"),
        hack_baseline=read_value("hackBaseline"),
        cx=read_value("Cx"),
        cy=read_value("Cy"),
        focal_length=read_value("focalLength"),
        distortion=(
            read_value("distortionK1"),
            read_value("distortionK2"),
            read_value("distortionK3"),
            read_value("distortionT1"),
            read_value("distortionT2"),
        ),
        auto_distortion=parse_bool(
            find_text(plugin, "autoDistortion"), f"{where}: autoDistortion", False
        ),
    )


def _read_triggered_camera(plugin: Element, where: str) -> CameraPlugin:
    topic = find_text(plugin, "triggerTopicName") or "image_trigger"
    return replace(_read_camera(plugin, where), trigger_topic=topic)


def _read_depth(plugin: Element, where: str, depth: DepthDescription) -> CameraPlugin:
    """Read the plug-in of a depth camera; `depth` contains the defaults for this plug-in."""
    made = _read_camera(plugin, where)
    nearest = parse_number(find_text(plugin, "pointCloudCutoff"), f"{where}: pointCloudCutoff", 0.4)
    millimetres = parse_bool(
        find_text(plugin, "useDepth16UC1Format"), f"{where}: useDepth16UC1Format", False)
    return replace(
        made,
        image_topic=find_text(plugin, "imageTopicName") or "ir/image_raw",
        info_topic=find_text(plugin, "cameraInfoTopicName") or "ir/camera_info",
        depth=replace(
            depth, nearest=nearest, millimetres=millimetres,
            image=find_text(plugin, "depthImageTopicName") or depth.image,
            info=find_text(plugin, "depthImageCameraInfoTopicName") or depth.info,
            points=find_text(plugin, "pointCloudTopicName") or "points",
        ),
    )


def _read_depth_camera(plugin: Element, where: str) -> CameraPlugin:
    return _read_depth(plugin, where, DepthDescription(rows=False))


def _read_kinect(plugin: Element, where: str) -> CameraPlugin:
    farthest = parse_number(
        find_text(plugin, "pointCloudCutoffMax"), f"{where}: pointCloudCutoffMax", 5.0
    )
    return _read_depth(plugin, where, DepthDescription(farthest=farthest))


def _read_sensor(plugin: Element, where: str, kind: str, **settings: object) -> SensorDescription:
    """Read the settings that all motion and force sensor plug-ins have in common."""

    def read_vector(tag: str) -> Vector3:
        return parse_numbers(find_text(plugin, tag), 3, f"{where}: {tag}", ZERO)

    noise = parse_number(find_text(plugin, "gaussianNoise"), f"{where}: gaussianNoise", 0.0)
    rate = parse_number(find_text(plugin, "updateRate"), f"{where}: updateRate", 0.0)
    made = SensorDescription(
        kind,
        find_text(plugin, "topicName") or "",
        namespace=find_text(plugin, "robotNamespace") or "",
        frame=find_text(plugin, "frameName") or "",
        rate=rate,
        noise=noise,
        offset=(read_vector("xyzOffset"), read_vector("rpyOffset")),
        link=find_text(plugin, "bodyName") or "",
    )
    made = replace(made, **settings)
    for name, value in (("the noise", made.noise), ("the rate", made.rate)):
        if value < 0.0:
            raise DescriptionError(f"{where}: {name} is {value}; it must not be negative")
    return made


def _read_pose_sensor(plugin: Element, where: str) -> SensorDescription:
    return _read_sensor(plugin, where, "pose", frame=find_text(plugin, "frameName") or "world")


def _read_body_imu(plugin: Element, where: str) -> SensorDescription:
    topic = find_text(plugin, "topicName")
    return _read_sensor(plugin, where, "body_imu", topic="/default_imu" if topic is None else topic)


def _read_imu(plugin: Element, where: str) -> SensorDescription:
    reference = "initialOrientationAsReference"
    return _read_sensor(
        plugin, where, "imu", topic=find_text(plugin, "topicName") or "imu_data",
        namespace=find_text(plugin, "robotNamespace"),
        rate=parse_number(find_text(plugin, "updateRateHZ"), f"{where}: updateRateHZ", 1.0),
        from_start=parse_bool(find_text(plugin, reference), f"{where}: {reference}", False),
    )


def _read_wrench(plugin: Element, where: str) -> SensorDescription:
    return _read_sensor(
        plugin, where, "wrench", joint=find_text(plugin, "jointName") or "", frame=""
    )


def _read_bumper(plugin: Element, where: str) -> SensorDescription:
    return _read_sensor(plugin, where, "contact",
                   topic=find_text(plugin, "bumperTopicName") or "bumper_states",
                   frame=find_text(plugin, "frameName") or "world", noise=0.0, rate=0.0)


def _read_joint_states(plugin: Element, where: str) -> SensorDescription:
    names = (name.strip() for name in (find_text(plugin, "jointName") or "").split(","))
    return _read_sensor(
        plugin, where, "joint_states", topic="joint_states",
        namespace=find_text(plugin, "robotNamespace"), frame="", noise=0.0,
        rate=parse_number(find_text(plugin, "updateRate"), f"{where}: updateRate", 100.0),
        joints=tuple(name for name in names if name))


def _read_grasp(plugin: Element, _where: str) -> GraspFixPlugin:
    # imported late, because few robots have this plug-in
    from aras_sim_bridge.description import grasp_tags

    return grasp_tags.read(plugin)


def _read_link_attacher(_plugin: Element, _where: str) -> LinkAttacherPlugin:
    return LinkAttacherPlugin()


PLUGINS: Mapping[str, Callable[[Element, str], Plugin]] = MappingProxyType({
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
