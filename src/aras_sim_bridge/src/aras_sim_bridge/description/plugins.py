"""The plug-ins that are served, by file name; an element's others are named in a warning."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import TypeVar
from xml.etree.ElementTree import Element

from aras_sim_bridge.description import served
from aras_sim_bridge.description.types import (
    CameraPlugin,
    ControlPlugin,
    DepthTopics,
    GraspDescription,
    LinkAttacher,
    SensorDescription,
)
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base.poses import Vector3
from aras_visual_servo_base.safe_xml import number, numbers, shorten, text_of, truth
from aras_visual_servo_base.urdf import ZERO

Plugin = ControlPlugin | CameraPlugin | SensorDescription | GraspDescription | LinkAttacher
Kind = TypeVar("Kind", bound=Plugin)


def read(element: Element, where: str, kinds: tuple[type[Kind], ...], warnings: list[str],
         mimics: Collection[str] = ()) -> list[Kind]:
    """The plug-ins of `element` that are of these kinds; a warning names each other file, once.

    mimics: joints that have a `<mimic>`.

    Raises:
        DescriptionError: a plug-in that is served, with a setting that it cannot have.
    """
    found = []
    for plugin in element.findall("plugin"):
        filename = shorten(plugin.get("filename") or "")
        name = filename.rpartition("/")[2].removeprefix("lib").removesuffix(".so")
        make = PLUGINS.get(name)
        made = None if make is None else make(plugin, where)
        if isinstance(made, kinds):
            found.append(made)
            warnings += served.unserved(plugin, f"plugin {name}", f"{where}: plugin '{filename}'")
            continue
        problem = "is not known; ignored" if made is None else "does not belong here; ignored"
        if "mimic_joint" in filename:
            problem = _without_mimic_plugin(plugin, mimics)
        warning = f"{where}: plugin '{filename}' {problem}"
        if warning not in warnings:
            warnings.append(warning)
    return found


def _without_mimic_plugin(plugin: Element, mimics: Collection[str]) -> str:
    """What becomes of a joint that a plug-in lets follow another one."""
    joint, follower = text_of(plugin, "joint") or "", text_of(plugin, "mimicJoint") or ""
    if follower in mimics:
        return "is not needed: <mimic> already works"
    return (f"is not served: give joint '{shorten(follower)}' a <mimic "
            f"joint='{shorten(joint)}'/>, which works")


def _control(plugin: Element, where: str) -> ControlPlugin:
    where = "plugin gazebo_ros_control"
    period = text_of(plugin, "controlPeriod")
    value = None if period is None else number(period, f"{where}: controlPeriod")
    if value is not None and value <= 0.0:
        raise DescriptionError(f"{where}: controlPeriod is {value} s; it must be positive")
    return ControlPlugin(
        robot_namespace=text_of(plugin, "robotNamespace"),
        control_period=value,
        e_stop_topic=text_of(plugin, "eStopTopic"),
    )


def _camera(plugin: Element, where: str) -> CameraPlugin:
    def value(tag: str) -> float:
        return number(text_of(plugin, tag), f"{where}: {tag}", 0.0)

    return CameraPlugin(
        robot_namespace=text_of(plugin, "robotNamespace") or "",
        camera_name=text_of(plugin, "cameraName") or "",
        image_topic=text_of(plugin, "imageTopicName") or "image_raw",
        info_topic=text_of(plugin, "cameraInfoTopicName") or "camera_info",
        frame_name=text_of(plugin, "frameName") or "",
        update_rate=value("updateRate"),
        hack_baseline=value("hackBaseline"),
        cx=value("Cx"), cy=value("Cy"), focal_length=value("focalLength"),
        distortion=(value("distortionK1"), value("distortionK2"), value("distortionK3"),
                    value("distortionT1"), value("distortionT2")),
        auto_distortion=truth(text_of(plugin, "autoDistortion"), f"{where}: autoDistortion", False),
    )


def _triggered(plugin: Element, where: str) -> CameraPlugin:
    topic = text_of(plugin, "triggerTopicName") or "image_trigger"
    return replace(_camera(plugin, where), trigger_topic=topic)


def _depth(plugin: Element, where: str, depth: DepthTopics) -> CameraPlugin:
    """`depth`: what differs between depth cameras."""
    made = _camera(plugin, where)
    nearest = number(text_of(plugin, "pointCloudCutoff"), f"{where}: pointCloudCutoff", 0.4)
    millimetres = truth(
        text_of(plugin, "useDepth16UC1Format"), f"{where}: useDepth16UC1Format", False)
    return replace(
        made,
        image_topic=text_of(plugin, "imageTopicName") or "ir/image_raw",
        info_topic=text_of(plugin, "cameraInfoTopicName") or "ir/camera_info",
        depth=replace(
            depth, nearest=nearest, millimetres=millimetres,
            image=text_of(plugin, "depthImageTopicName") or depth.image,
            info=text_of(plugin, "depthImageCameraInfoTopicName") or depth.info,
            points=text_of(plugin, "pointCloudTopicName") or "points",
        ),
    )


def _depth_camera(plugin: Element, where: str) -> CameraPlugin:
    return _depth(plugin, where, DepthTopics(rows=False))


def _kinect(plugin: Element, where: str) -> CameraPlugin:
    farthest = number(text_of(plugin, "pointCloudCutoffMax"), f"{where}: pointCloudCutoffMax", 5.0)
    return _depth(plugin, where, DepthTopics(farthest=farthest))


def _sensor(plugin: Element, where: str, kind: str, **settings: object) -> SensorDescription:
    """What the plug-ins of all sensors of motion and forces have in common."""

    def vector(tag: str) -> Vector3:
        return numbers(text_of(plugin, tag), 3, f"{where}: {tag}", ZERO)

    noise = number(text_of(plugin, "gaussianNoise"), f"{where}: gaussianNoise", 0.0)
    rate = number(text_of(plugin, "updateRate"), f"{where}: updateRate", 0.0)
    made = SensorDescription(
        kind, text_of(plugin, "topicName") or "",
        namespace=text_of(plugin, "robotNamespace") or "",
        frame=text_of(plugin, "frameName") or "", rate=rate, noise=noise,
        offset=(vector("xyzOffset"), vector("rpyOffset")), link=text_of(plugin, "bodyName") or "",
    )
    made = replace(made, **settings)
    for name, value in (("the noise", made.noise), ("the rate", made.rate)):
        if value < 0.0:
            raise DescriptionError(f"{where}: {name} is {value}; it must not be negative")
    return made


def _pose(plugin: Element, where: str) -> SensorDescription:
    return _sensor(plugin, where, "pose", frame=text_of(plugin, "frameName") or "world")


def _body_imu(plugin: Element, where: str) -> SensorDescription:
    topic = text_of(plugin, "topicName")
    return _sensor(plugin, where, "body_imu", topic="/default_imu" if topic is None else topic)


def _imu(plugin: Element, where: str) -> SensorDescription:
    reference = "initialOrientationAsReference"
    return _sensor(
        plugin, where, "imu", topic=text_of(plugin, "topicName") or "imu_data",
        namespace=text_of(plugin, "robotNamespace"),
        rate=number(text_of(plugin, "updateRateHZ"), f"{where}: updateRateHZ", 1.0),
        from_start=truth(text_of(plugin, reference), f"{where}: {reference}", False),
    )


def _wrench(plugin: Element, where: str) -> SensorDescription:
    return _sensor(plugin, where, "wrench", joint=text_of(plugin, "jointName") or "", frame="")


def _bumper(plugin: Element, where: str) -> SensorDescription:
    return _sensor(plugin, where, "contact",
                   topic=text_of(plugin, "bumperTopicName") or "bumper_states",
                   frame=text_of(plugin, "frameName") or "world", noise=0.0, rate=0.0)


def _joint_states(plugin: Element, where: str) -> SensorDescription:
    names = (name.strip() for name in (text_of(plugin, "jointName") or "").split(","))
    return _sensor(
        plugin, where, "joint_states", topic="joint_states",
        namespace=text_of(plugin, "robotNamespace"), frame="", noise=0.0,
        rate=number(text_of(plugin, "updateRate"), f"{where}: updateRate", 100.0),
        joints=tuple(name for name in names if name))


def _grasp(plugin: Element, _where: str) -> GraspDescription:
    from aras_sim_bridge.description import grasp_tags  # few robots grasp

    return grasp_tags.read(plugin)


def _link_attacher(_plugin: Element, _where: str) -> LinkAttacher:
    return LinkAttacher()


PLUGINS: Mapping[str, Callable[[Element, str], Plugin]] = MappingProxyType({
    "gazebo_ros_control": _control,
    "gazebo_ros_camera": _camera,
    "gazebo_ros_multicamera": _camera,
    "gazebo_ros_triggered_camera": _triggered,
    "gazebo_ros_triggered_multicamera": _triggered,
    "gazebo_ros_depth_camera": _depth_camera,
    "gazebo_ros_openni_kinect": _kinect,
    "gazebo_ros_p3d": _pose,
    "gazebo_ros_imu": _body_imu,
    "gazebo_ros_imu_sensor": _imu,
    "gazebo_ros_ft_sensor": _wrench,
    "gazebo_ros_bumper": _bumper,
    "gazebo_ros_joint_state_publisher": _joint_states,
    "gazebo_grasp_fix": _grasp,
    "gazebo_ros_link_attacher": _link_attacher,
})
