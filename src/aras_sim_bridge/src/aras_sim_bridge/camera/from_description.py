"""Conversion of the sensor and plug-in elements of a URDF to camera settings."""

from __future__ import annotations

import logging
from dataclasses import asdict

from ..description import CameraDescription
from ..errors import CameraError
from .lens import LARGEST_ANGLE

_log = logging.getLogger(__name__)

# Names of lenses in CameraConfig, by the lens types of SDF.
_LENSES = {"gnomonical": "pinhole", "stereographic": "stereographic",
           "equidistant": "equidistant", "equisolid_angle": "equisolid",
           "orthographic": "orthographic"}


def read_settings(camera: CameraDescription) -> dict[str, object]:
    """Return the settings of CameraConfig that a description of a camera contains.

    The <distortion> of the sensor affects the image. As in Gazebo, the distortion, Cx, Cy and
    focalLength of the camera's plug-in do not affect the image. They are only used for CameraInfo,
    if legacy_camera_info is set.

    Raises:
        CameraError: the lens type is not supported.
    """
    xyz, rpy = camera.pose
    values: dict[str, object] = {
        "name": camera.name, "link": camera.link, "xyz": xyz, "rpy": rpy,
        "width": camera.width, "height": camera.height, "horizontal_fov": camera.horizontal_fov,
        "format": camera.format, "near": camera.near, "far": camera.far,
    }
    if camera.kind == "depth":
        values["depth"] = True
    if camera.shutter:
        values["shutter"] = camera.shutter
    rates = [camera.update_rate]
    plugin = camera.plugin
    if plugin is not None:
        rates.append(plugin.update_rate)
        plugin_D = plugin.distortion
        if plugin.auto_distortion:
            plugin_D = camera.distortion or (0.0,) * 5
        values |= {
            "camera_name": plugin.camera_name, "robot_namespace": plugin.robot_namespace,
            "image_topic": plugin.image_topic, "info_topic": plugin.info_topic,
            "frame_name": plugin.frame_name, "hack_baseline": plugin.hack_baseline,
            "trigger_topic": plugin.trigger_topic,
            "declared": (plugin.focal_length, plugin.cx, plugin.cy, *_reorder_distortion(plugin_D)),
        }
        if plugin.depth is not None:
            values |= {"depth": True, "depth_topics": asdict(plugin.depth)}
    if any(rates):
        values["update_rate"] = min(filter(None, rates))
    if camera.kind == "wideanglecamera":
        values |= _read_wide_lens(camera)
    elif camera.lens is not None and camera.lens.intrinsics is not None:
        # Gazebo measures cx and cy from the image's corner; a camera matrix measures them from the
        # centre of the first pixel.
        fx, fy, cx, cy = camera.lens.intrinsics
        values["camera_matrix"] = (fx, fy, cx - 0.5, cy - 0.5)
    if camera.distortion and any(camera.distortion):
        values["distortion_model"] = "plumb_bob"
        values["distortion_coefficients"] = _reorder_distortion(camera.distortion)
        if camera.distortion_center != (0.5, 0.5):
            _log.warning("camera '%s': <center> %s of the <distortion> is ignored, because the "
                         "distortion is centred on the optical axis; set it to 0.5 0.5",
                         camera.name, camera.distortion_center)
    noise = camera.noise
    if noise.kind.startswith("gaussian") and (noise.mean or noise.stddev):
        # SDF gives noise as a fraction of the largest value; CameraConfig gives it in grey levels.
        values["effects"] = {"noise_mean": 255.0 * noise.mean, "noise_stddev": 255.0 * noise.stddev}
    return values


def _reorder_distortion(k1_k2_k3_p1_p2: tuple[float, ...]) -> tuple[float, ...]:
    k1, k2, k3, p1, p2 = k1_k2_k3_p1_p2
    return k1, k2, p1, p2, k3


def _read_wide_lens(camera: CameraDescription) -> dict[str, object]:
    lens = camera.lens
    if lens is None:
        return {"lens": "equidistant"}
    if lens.kind not in _LENSES:
        raise CameraError(
            f"camera '{camera.name}': lens type '{lens.kind}' is not supported; use one of "
            + ", ".join(sorted(_LENSES))
        )
    values: dict[str, object] = {"lens": _LENSES[lens.kind]}
    if values["lens"] != "pinhole":
        values["cutoff_angle"] = min(lens.cutoff_angle, LARGEST_ANGLE[values["lens"]])
    # Without <scale_to_hfov>, the focal length is half the image width, for any field of view.
    if not lens.scale_to_hfov:
        half = camera.width / 2
        values["camera_matrix"] = (half, half, half - 0.5, (camera.height - 1) / 2)
    return values
