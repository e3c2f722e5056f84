"""The <gazebo> tags of a URDF: plugins, sensors, materials, link flags."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from xml.etree.ElementTree import Element

from aras_sim_bridge.description import gazebo_materials
from aras_sim_bridge.description.types import (
    CameraDescription,
    CameraPlugin,
    ControlPlugin,
    LensDescription,
    Link,
    Noise,
    Rgba,
)
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base.safe_xml import (
    check_names,
    integer,
    number,
    numbers,
    shorten,
    text_of,
    truth,
)
from aras_visual_servo_base.urdf import Joint

CAMERA_KINDS = ("camera", "depth", "wideanglecamera")
_LENSES = ("gnomonical", "stereographic", "equidistant", "equisolid_angle", "orthographic",
           "custom")


@dataclass
class GazeboTags:
    """What `parse` found; links are the given ones with their flags set."""

    links: dict[str, Link]
    control_plugins: tuple[ControlPlugin, ...] = ()
    cameras: tuple[CameraDescription, ...] = ()
    colours: dict[str, Rgba] = field(default_factory=dict)
    static: bool = False


def parse(root: Element, links: dict[str, Link], joints: Mapping[str, Joint],
          warnings: list[str]) -> GazeboTags:
    """Read every `<gazebo>` below `root`.

    A reference to nothing and an unknown plugin or sensor are warnings, as in Gazebo; a tag that
    is understood but wrong is a DescriptionError.
    """
    tags = GazeboTags(dict(links))
    plugins: list[ControlPlugin] = []
    cameras: list[CameraDescription] = []
    for block in root.findall("gazebo"):
        reference = block.get("reference")
        if reference is None:
            tags.static = truth(text_of(block, "static"), "<gazebo>: static", tags.static)
            for plugin in block.findall("plugin"):
                filename = plugin.get("filename") or ""
                if "gazebo_ros_control" in filename:
                    plugins.append(_control_plugin(plugin))
                else:
                    warnings.append(f"plugin '{shorten(filename)}' is not known; ignored")
        elif reference in links:
            _link_flags(block, reference, tags, warnings)
            for sensor in block.findall("sensor"):
                kind = sensor.get("type") or ""
                if kind in CAMERA_KINDS:
                    cameras.append(camera(sensor, reference))
                else:
                    warnings.append(
                        f"link '{reference}': sensor type '{shorten(kind)}' is not known; ignored"
                    )
        elif reference not in joints:
            warnings.append(
                f"<gazebo reference='{shorten(reference)}'> names no link or joint; ignored"
            )
    check_names([camera.name for camera in cameras], "cameras")
    tags.control_plugins, tags.cameras = tuple(plugins), tuple(cameras)
    return tags


def _setting(block: Element, tag: str) -> str | None:
    """Text of a child, or its attribute `value`, as old URDF files have it."""
    child = block.find(tag)
    if child is not None and child.get("value") is not None:
        return child.get("value")
    return text_of(block, tag)


def _link_flags(block: Element, name: str, tags: GazeboTags, warnings: list[str]) -> None:
    where = f"<gazebo reference='{name}'>"
    link = tags.links[name]
    material = _setting(block, "material")
    if material:
        tags.colours[name] = gazebo_materials.colour(material, name, warnings)
    gravity = truth(_setting(block, "gravity"), f"{where}: gravity", link.gravity)
    if truth(_setting(block, "turnGravityOff"), f"{where}: turnGravityOff", False):
        gravity = False
    mu = _setting(block, "mu1")
    friction = link.mu if mu is None else number(mu, f"{where}: mu1")
    if friction is not None and friction < 0.0:
        raise DescriptionError(f"{where}: mu1 is {friction}; it must not be negative")
    tags.links[name] = replace(
        link, gravity=gravity, mu=friction,
        kinematic=truth(_setting(block, "kinematic"), f"{where}: kinematic", link.kinematic),
    )


def _control_plugin(plugin: Element) -> ControlPlugin:
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


def camera(sensor: Element, link: str) -> CameraDescription:
    """The camera sensor `sensor` on `link`; also used for SDF, whose element is the same.

    Raises:
        DescriptionError: an element that is no number, or a size, rate, angle or clip distance
            that no camera has.
    """
    name = sensor.get("name") or ""
    where = f"camera '{shorten(name)}' on link '{link}'"
    if not name:
        raise DescriptionError(f"link '{link}': a camera sensor has no name")
    node = sensor.find("camera")
    if node is None:
        raise DescriptionError(f"{where}: has no <camera> element")
    image, clip = node.find("image"), node.find("clip")
    pose = numbers(text_of(sensor, "pose"), 6, f"{where}: pose", (0.0,) * 6)
    near = number(text_of(clip, "near"), f"{where}: clip near", 0.1)
    far = number(text_of(clip, "far"), f"{where}: clip far", 100.0)
    width = integer(text_of(image, "width"), f"{where}: image width", 320)
    height = integer(text_of(image, "height"), f"{where}: image height", 240)
    rate = number(text_of(sensor, "update_rate"), f"{where}: update_rate", 0.0)
    fov = number(text_of(node, "horizontal_fov"), f"{where}: horizontal_fov", 1.047)
    kind = sensor.get("type") or "camera"
    widest = 6.283185307179587 if kind == "wideanglecamera" else 3.14159
    for wrong, problem in (
        (not 1 <= width <= 16384 or not 1 <= height <= 16384,
         f"image is {width} × {height} pixels; 1 … 16384 are possible"),
        (not 0.0 < near < far, f"clip near {near} and far {far} need 0 < near < far"),
        (rate < 0.0, f"update_rate is {rate} Hz; it must not be negative"),
        (not 0.0 < fov <= widest, f"horizontal_fov is {fov} rad; it must be in (0, {widest:.5g}]"),
    ):
        if wrong:
            raise DescriptionError(f"{where}: {problem}")
    plugin = next(
        (p for p in sensor.findall("plugin") if "camera" in (p.get("filename") or "")
         or "kinect" in (p.get("filename") or "")), None,
    )
    distortion, center = _distortion(node, where)
    return CameraDescription(
        name=name, link=link, pose=((pose[0], pose[1], pose[2]), (pose[3], pose[4], pose[5])),
        kind=kind, update_rate=rate, horizontal_fov=fov, width=width, height=height,
        format=text_of(image, "format") or "R8G8B8", near=near, far=far,
        noise=_noise(node, where), distortion=distortion, distortion_center=center,
        lens=_lens(node, where), plugin=None if plugin is None else _camera_plugin(plugin, where),
    )


def _noise(node: Element, where: str) -> Noise:
    noise = node.find("noise")
    if noise is None:
        return Noise()
    stddev = number(text_of(noise, "stddev"), f"{where}: noise stddev", 0.0)
    if stddev < 0.0:
        raise DescriptionError(f"{where}: noise stddev is {stddev}; it must not be negative")
    kind = text_of(noise, "type") or noise.get("type") or "gaussian"
    return Noise(kind, number(text_of(noise, "mean"), f"{where}: noise mean", 0.0), stddev)


def _distortion(node: Element, where: str) -> tuple[tuple[float, ...] | None, tuple[float, ...]]:
    distortion = node.find("distortion")
    if distortion is None:
        return None, (0.5, 0.5)
    values = tuple(
        number(text_of(distortion, key), f"{where}: distortion {key}", 0.0)
        for key in ("k1", "k2", "k3", "p1", "p2")
    )
    center = text_of(distortion, "center")
    return values, numbers(center, 2, f"{where}: distortion center", (0.5, 0.5))


def _lens(node: Element, where: str) -> LensDescription | None:
    lens = node.find("lens")
    if lens is None:
        return None
    kind = text_of(lens, "type") or "gnomonical"
    if kind not in _LENSES:
        raise DescriptionError(
            f"{where}: lens type '{shorten(kind)}' is unknown; use one of {', '.join(_LENSES)}"
        )
    return LensDescription(
        kind=kind,
        scale_to_hfov=truth(text_of(lens, "scale_to_hfov"), f"{where}: scale_to_hfov", True),
        cutoff_angle=number(text_of(lens, "cutoff_angle"), f"{where}: cutoff_angle",
                            LensDescription.cutoff_angle),
    )


def _camera_plugin(plugin: Element, where: str) -> CameraPlugin:
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


