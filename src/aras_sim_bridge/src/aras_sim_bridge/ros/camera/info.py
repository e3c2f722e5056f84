"""Create CameraInfo messages, and write the calibration files of the service set_camera_info."""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path

import numpy as np
import rospy
import yaml
from sensor_msgs.msg import CameraInfo

from aras_sim_bridge.camera import CameraConfig, CameraIntrinsics
from aras_sim_bridge.errors import CameraError

SENSOR_HEADER = """\
# Row r of h is exposed for exposure_time around stamp + (r - (h - 1) / 2) * row_time (all in s).
# sensor: gain in grey levels (of 255) per electron, full_well and read_noise in electrons,
# dark_current in electrons per second. The keys are those of a camera preset.
"""
SENSOR_KEYS = ("row_time", "rows_together", "exposure_time", "exposure_samples", "exposure", "gain",
               "noise_mean", "noise_stddev", "shot_noise", "vignetting")  # fmt: skip


def to_camera_info(info: CameraIntrinsics) -> CameraInfo:
    """Return the camera intrinsics as a CameraInfo message without stamp and frame."""
    return CameraInfo(
        height=info.height,
        width=info.width,
        distortion_model=info.model,
        D=_flatten(info.D),
        K=_flatten(info.K),
        R=_flatten(info.R),
        P=_flatten(info.P),
    )


def add_prefix(frame_id: str, namespace: str) -> str:
    """Return `frame_id` with the prefix from the parameter tf_prefix, if there is one.

    The parameter is looked up in `namespace`, then in its parent namespaces up to the root.
    """
    frame_id = frame_id.lstrip("/")
    parts = [part for part in namespace.split("/") if part]
    for count in range(len(parts), -1, -1):
        prefix = str(rospy.get_param("/" + "/".join([*parts[:count], "tf_prefix"]), "")).strip("/")
        if prefix:
            return f"{prefix}/{frame_id}"
    return frame_id


def find_calibration_path(camera_name: str) -> Path:
    """Return the file in which camera_info_manager stores the calibration of a camera.

    Raises:
        CameraError: the camera's name is empty, or a part of it starts with a dot.
    """
    parts = [part for part in camera_name.split("/") if part]
    if not parts or any(part.startswith(".") for part in parts):
        raise CameraError(f"cameraName '{camera_name}' cannot be used as a file name; rename the "
                          "camera")
    home = Path(os.environ.get("ROS_HOME") or Path.home() / ".ros")
    return home.joinpath("camera_info", *parts[:-1], parts[-1] + ".yaml")


def save_calibration(info: CameraInfo, camera_name: str, config: CameraConfig) -> Path:
    """Write a calibration in the format of camera_calibration_parsers and return its path.

    Parameters of the image sensor that CameraInfo lacks are written to NAME_sensor.yaml in the same
    folder.

    Raises:
        CameraError: the name of the camera is not a valid file name.
        OSError: a file cannot be written.
    """
    path = find_calibration_path(camera_name)
    path.parent.mkdir(parents=True, exist_ok=True)
    sensor_path = path.with_name(f"{path.stem}_sensor.yaml")
    texts = {path: _format_calibration(info, camera_name), sensor_path: format_sensor_yaml(config)}
    for file, text in texts.items():
        # Replace the file atomically, so that no other process reads an incomplete file.
        temporary = file.with_name(file.name + ".new")
        temporary.write_text(text, encoding="utf-8")
        temporary.replace(file)
    return path


def format_sensor_yaml(config: CameraConfig) -> str:
    """Return the settings of shutter, exposure and noise as YAML; CameraInfo does not contain them.
    """
    settings = {key: getattr(config.effects, key) for key in SENSOR_KEYS}
    for key in ("sensor", "auto_exposure"):
        if (part := getattr(config.effects, key)) is not None:
            settings[key] = asdict(part)
    if config.effects.further:
        settings["further"] = {key: dict(value) for key, value in config.effects.further.items()}
    return SENSOR_HEADER + yaml.safe_dump({"effects": settings}, sort_keys=False)


def _flatten(values: np.ndarray) -> list[float]:
    return np.asarray(values, float).ravel().tolist()


def _format_calibration(info: CameraInfo, name: str) -> str:
    """Return a calibration as YAML text for camera_calibration_parsers."""

    def format_matrix(rows: int, values: list[float]) -> dict[str, object]:
        data = [float(value) for value in values]
        return {"rows": rows, "cols": len(data) // rows, "data": data}

    return yaml.safe_dump(
        {
            "image_width": info.width,
            "image_height": info.height,
            "camera_name": name,
            "camera_matrix": format_matrix(3, info.K),
            "distortion_model": info.distortion_model,
            "distortion_coefficients": format_matrix(1, info.D),
            "rectification_matrix": format_matrix(3, info.R),
            "projection_matrix": format_matrix(3, info.P),
        },
        sort_keys=False,
    )
