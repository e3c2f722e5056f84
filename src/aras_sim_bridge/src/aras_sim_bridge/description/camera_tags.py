"""Readers of camera sensors; URDF and SDF use the same elements for them."""

import copy
from collections.abc import Iterator
from dataclasses import replace
from xml.etree.ElementTree import Element

from aras_sim_bridge.description import plugins
from aras_sim_bridge.description.camera_types import (
    CameraDescription,
    CameraPlugin,
    LensDescription,
    PixelNoise,
)
from aras_sim_bridge.description.sdf_dialects import unify
from aras_sim_bridge.errors import DescriptionError
from aras_visual_servo_base import safe_xml
from aras_visual_servo_base.safe_xml import ElementReader, shorten
from aras_visual_servo_base.urdf import CAMERA_KINDS, read_camera_pose

_LENSES = ("gnomonical", "stereographic", "equidistant", "equisolid_angle", "orthographic",
           "custom")


def read_cameras(sensor: Element, link: str, warnings: list[str]) -> list[CameraDescription]:
    """Read the camera of a sensor on `link`, or each camera of a multicamera.

    The topics of a camera in a multicamera are below cameraName/left if the camera's name contains
    "left", below cameraName/right if it contains "right", otherwise below cameraName/<name>. Only
    the right camera has the plug-in's `hackBaseline`, as in gazebo_ros.

    Raises:
        DescriptionError: the text of an element is not a number, or a size, rate, angle or clip
            distance is not possible for a camera.
    """
    name = sensor.get("name") or ""
    where = f"camera '{shorten(name)}' on link '{link}'"
    if not name:
        raise DescriptionError(f"link '{link}': a camera sensor has no name; give it one")
    nodes = sensor.findall("camera")
    if not nodes:
        raise DescriptionError(f"{where}: <camera> is missing; add it")
    found = plugins.read(sensor, where, (CameraPlugin,), warnings)
    plugin = found[0] if found else None
    for extra in found[1:]:
        warnings.append(f"{where}: plug-in '{extra.camera_name}' is ignored, because only one "
                        "plug-in can publish the camera's images; remove one")
    if plugin and not plugin.trigger_topic and sensor.find("plugin/triggerTopicName") is not None:
        warnings.append(f"{where}: <triggerTopicName> works only with "
                        "libgazebo_ros_triggered_camera.so; this camera publishes all the time; "
                        "use that plug-in or remove the element")
    if sensor.get("type") != "multicamera":
        return [_read_camera(sensor, nodes[0], name, link, where, plugin, warnings)]
    cameras = []
    for i, node in enumerate(nodes):
        camera_name = node.get("name") or str(i)
        side = next((word for word in ("left", "right") if word in camera_name), camera_name)
        camera_plugin = None if plugin is None else replace(
            plugin, camera_name=f"{plugin.camera_name}/{side}",
            hack_baseline=plugin.hack_baseline if side == "right" else 0.0)
        camera = _read_camera(
            sensor, node, f"{name}_{camera_name}", link,
            f"{where}, camera '{shorten(camera_name)}'", camera_plugin, warnings,
        )
        cameras.append(replace(camera, shutter=name))
    return cameras


def _read_camera(sensor: Element, node: Element, name: str, link: str, where: str,
                 plugin: CameraPlugin | None, warnings: list[str]) -> CameraDescription:
    """Read the camera that `node`, a <camera> of `sensor`, describes."""
    camera = ElementReader(node, f"{where}: ")
    image, clip = camera.get_child("image"), camera.get_child("clip")
    near, far = clip.read_number("near", 0.1), clip.read_number("far", 100.0)
    width, height = image.read_integer("width", 320), image.read_integer("height", 240)
    rate = ElementReader(sensor, f"{where}: ").read_number("update_rate", 0.0)
    fov = camera.read_number("horizontal_fov", 1.047)
    kind = sensor.get("type") or "camera"
    widest = 6.283185307179587 if kind == "wideanglecamera" else 3.14159
    for wrong, problem in (
        (not 1 <= width <= 16384 or not 1 <= height <= 16384,
         f"image is {width} × {height} pixels; each side must be 1 … 16384"),
        (not 0.0 < near < far, f"clip near {near} and far {far} need 0 < near < far"),
        (rate < 0.0, f"update_rate is {rate} Hz; it must not be negative"),
        (not 0.0 < fov <= widest, f"horizontal_fov is {fov} rad; it must be in (0, {widest:.5g}]"),
    ):
        if wrong:
            raise DescriptionError(f"{where}: {problem}")
    distortion, centre = camera.get_child("distortion"), (0.5, 0.5)
    coefficients = None
    if distortion.element is not None:
        coefficients = tuple(
            distortion.read_number(key, 0.0) for key in ("k1", "k2", "k3", "p1", "p2")
        )
        centre = distortion.read_numbers("center", 2, centre)
    return CameraDescription(
        name=name,
        link=link,
        pose=read_camera_pose(sensor, node, where),
        kind=kind,
        update_rate=rate,
        horizontal_fov=fov,
        width=width,
        height=height,
        format=image.read_text("format") or "R8G8B8",
        near=near,
        far=far,
        noise=_read_noise(camera.get_child("noise")),
        distortion=coefficients,
        distortion_center=centre,
        lens=_read_lens(node.find("lens"), where, kind, warnings),
        plugin=plugin,
    )


def _read_noise(noise: ElementReader) -> PixelNoise:
    if noise.element is None:
        return PixelNoise()
    stddev = noise.read_number("stddev", 0.0)
    if stddev < 0.0:
        raise DescriptionError(f"{noise.prefix}stddev is {stddev}; it must not be negative")
    kind = noise.read_text("type") or noise.element.get("type") or "gaussian"
    return PixelNoise(kind, noise.read_number("mean", 0.0), stddev)


def _read_lens(
    element: Element | None, where: str, camera: str, warnings: list[str]
) -> LensDescription | None:
    if element is None:
        return None
    lens = ElementReader(element, f"{where}: ")
    kind = lens.read_text("type") or "gnomonical"
    if kind not in _LENSES:
        raise DescriptionError(
            f"{where}: lens type '{shorten(kind)}' is unknown; use one of {', '.join(_LENSES)}"
        )
    given, intrinsics = lens.get_child("intrinsics"), None
    if given.element is not None and camera == "wideanglecamera":
        warnings.append(f"{where}: <intrinsics> is ignored, because a wideanglecamera has none; "
                        "remove <intrinsics>")
    elif given.element is not None:
        # SDF's default intrinsics, px.
        defaults = {"fx": 277.0, "fy": 277.0, "cx": 160.0, "cy": 120.0}
        intrinsics = tuple(given.read_number(key, value) for key, value in defaults.items())
        if min(intrinsics[:2]) <= 0.0:
            raise DescriptionError(f"{where}: intrinsics fx {intrinsics[0]} and fy {intrinsics[1]} "
                                   "are focal lengths in pixels; they must be positive")
    if camera != "wideanglecamera" and kind != "gnomonical":
        warnings.append(f"{where}: lens type '{kind}' needs a wideanglecamera; this camera is "
                        "drawn as a pinhole camera")
    return LensDescription(
        intrinsics=intrinsics,
        kind=kind,
        scale_to_hfov=lens.read_bool("scale_to_hfov", True),
        cutoff_angle=lens.read_number("cutoff_angle", LensDescription.cutoff_angle),
    )


def parse_cameras(xml: str | Element) -> tuple[CameraDescription, ...]:
    """Read only the cameras of a URDF; if several have the same name, return the first.

    Raises:
        DescriptionError: the text is not XML, or an element of a camera is invalid.
    """
    cameras: dict[str, CameraDescription] = {}
    for link, sensor in _list_sensors(safe_xml.parse(xml, "URDF")):
        if sensor.get("type") in CAMERA_KINDS:
            sensor = copy.deepcopy(sensor)
            unify(sensor, [])
            for camera in read_cameras(sensor, link, []):
                cameras.setdefault(camera.name, camera)
    return tuple(cameras.values())


def _list_sensors(robot: Element) -> Iterator[tuple[str, Element]]:
    """Yield the sensors in the `<gazebo>` tags, each with the name of its link."""
    links = {link.get("name") for link in robot.findall("link")}
    for block in robot.findall("gazebo"):
        reference = block.get("reference")
        for place in block.findall("link") if reference is None else (block,):
            link = place.get("name") if reference is None else reference
            if reference is None or reference in links:
                yield from ((link, sensor) for sensor in place.findall("sensor"))
