"""Camera settings that a URDF's sensor and plugin elements give."""

from __future__ import annotations

import math
from typing import Any

from ..errors import CameraError

# SDF's lens types; gnomonical is the pinhole.
_LENSES = {"gnomonical": "pinhole", "stereographic": "stereographic",
           "equidistant": "equidistant", "equisolid_angle": "equisolid",
           "equisolid": "equisolid", "orthographic": "orthographic"}


def settings(camera: Any) -> dict[str, Any]:
    """CameraConfig's keys for a description.CameraDescription; what is None there stays out.

    As in Gazebo, the plugin's Cx, Cy, focalLength and distortion only describe a picture, so
    the rendered camera follows the sensor; its <distortion> is rendered. K always follows.
    """
    xyz, rpy = _pose(getattr(camera, "pose", None))
    values: dict[str, Any] = {
        "name": camera.name, "link": camera.link, "xyz": xyz, "rpy": rpy,
        "width": camera.width, "height": camera.height, "horizontal_fov": camera.horizontal_fov,
        "format": camera.format, "near": camera.near, "far": camera.far,
        "depth": camera.kind == "depth" or None,
    }
    rates = [camera.update_rate]
    plugin = getattr(camera, "plugin", None)
    if plugin is not None:
        rates.append(plugin.update_rate)
        values |= {
            "camera_name": plugin.camera_name, "robot_namespace": plugin.robot_namespace,
            "image_topic": plugin.image_topic, "info_topic": plugin.info_topic,
            "frame_name": plugin.frame_name, "hack_baseline": plugin.hack_baseline,
        }
    rates = [rate for rate in rates if rate]
    if rates:
        values["update_rate"] = min(rates)
    if camera.kind == "wideanglecamera":
        values |= _wide(camera)
    distortion = _numbers(getattr(camera, "distortion", None), ("k1", "k2", "k3", "p1", "p2"))
    if distortion and any(distortion.values()):
        values["distortion_model"] = "plumb_bob"
        values["distortion_coefficients"] = tuple(
            distortion[k] for k in ("k1", "k2", "p1", "p2", "k3")
        )
    noise = _numbers(getattr(camera, "noise", None), ("mean", "stddev"))
    if noise and noise["stddev"]:
        # SDF gives noise as a share of full scale.
        values["effects"] = {"noise_stddev": 255.0 * noise["stddev"]}
    return {key: value for key, value in values.items() if value is not None}


def _pose(pose: Any) -> tuple[tuple, tuple]:
    if pose is None:
        return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    if hasattr(pose, "xyz"):
        return tuple(pose.xyz), tuple(pose.rpy)
    if len(pose) == 6:
        return tuple(pose[:3]), tuple(pose[3:])
    return tuple(pose[0]), tuple(pose[1])


def _get(thing: Any, key: str) -> Any:
    return thing.get(key) if isinstance(thing, dict) else getattr(thing, key, None)


def _numbers(thing: Any, keys: tuple[str, ...]) -> dict[str, float] | None:
    """Named numbers of a mapping, a dataclass, or a plain sequence in that order."""
    if thing is None:
        return None
    if isinstance(thing, tuple | list):
        return {k: float(v) for k, v in zip(keys, [*thing, *[0.0] * len(keys)], strict=False)}
    return {key: float(_get(thing, key) or 0.0) for key in keys}


def _wide(camera: Any) -> dict[str, Any]:
    lens = getattr(camera, "lens", None)
    if lens is None:
        return {"lens": "equidistant"}
    kind = lens if isinstance(lens, str) else _get(lens, "kind")
    if kind not in _LENSES:
        raise CameraError(
            f"camera '{camera.name}': lens type '{kind}' is not drawn; take one of "
            + ", ".join(sorted(_LENSES))
        )
    values: dict[str, Any] = {"lens": _LENSES[kind]}
    cutoff = None if isinstance(lens, str) else _get(lens, "cutoff_angle")
    if cutoff and cutoff < math.radians(110.0) and values["lens"] != "pinhole":
        values["cutoff_angle"] = float(cutoff)
    return values
