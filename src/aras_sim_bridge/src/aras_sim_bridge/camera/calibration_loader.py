"""Calibration files: detection of the format, and application to the settings of a camera.

The content, not the file name, determines the format:

- ROS: camera_info files of camera_calibration and `~/.ros/camera_info`, messages printed by
  rostopic, and .ini files of camera_calibration_parsers;
- OpenCV: FileStorage in YAML, XML or JSON;
- Kalibr: camchain files;
- ViSP: files of vpXmlParserCamera;
- CamOdoCal, for example for VINS-Fusion; ORB-SLAM 2 and 3.

`FILE#NAME` selects one of several cameras in a file.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aras_visual_servo_base.setting_values import format_value
from aras_visual_servo_base.yaml_files import read_text

from ..errors import CameraError

if TYPE_CHECKING:
    from .calibration import Calibration

CALIBRATION_KEY = "calibration"
# Settings of a camera that its calibration determines. A value that differs from the calibration is
# an error.
LENS_KEYS = ("width", "height", "camera_matrix", "horizontal_fov", "lens", "distortion_model",
           "distortion_coefficients", "rectification_matrix", "projection_matrix")  # fmt: skip


def apply_calibration(settings: Mapping[str, Any], folder: Path | None = None) -> dict[str, Any]:
    """Replace the setting `calibration`, the path of a file, by the settings in that file.

    Args:
        settings: settings of a camera.
        folder: folder to which the path of the calibration is relative; None if the path must be
            absolute.

    Returns:
        New settings without `calibration`; a copy of `settings` if they do not contain this key.

    Raises:
        CameraError: the file is not a valid calibration, or a setting contradicts it.
    """
    if CALIBRATION_KEY not in settings:
        return dict(settings)
    name = settings[CALIBRATION_KEY]
    if not isinstance(name, str | Path):
        raise CameraError(
            f"calibration is {format_value(name)}, must be the path of a calibration file"
        )
    path, camera = split_name(name)
    if not path.is_absolute():
        if folder is None:
            raise CameraError(f"calibration '{name}' is a relative path: give an absolute path")
        path = folder / path
    found = find_calibration(read_text(path, CameraError), path, camera)
    if found is None:
            raise CameraError(f"{path} is not a calibration, because its keys are those of a "
                              "preset: give a calibration file")
    rest = {key: value for key, value in settings.items() if key != CALIBRATION_KEY}
    given = found.to_settings()
    for key in LENS_KEYS:
        if key in rest and (key == "horizontal_fov" or key in given and rest[key] != given[key]):
            other = f"{key} {format_value(given[key])}" if key in given else "the camera matrix"
            raise CameraError(f"{key} is {format_value(rest[key])}, but the calibration {path} "
                              f"already defines {other}: remove {key}")
    return {**given, **rest}


def find_calibration(text: str, path: Path, camera: str) -> Calibration | None:
    """Return the calibration of one camera from the text of a file.

    `camera` is the camera's name. It may be '' if the file contains only one camera or is a Kalibr
    camchain, whose first camera is then used. `path` is the file's path, for messages. Return None
    if the text is not a calibration.

    Raises:
        CameraError: the calibration is invalid, or `camera` does not select one of its cameras.
    """
    from .calibration_formats import find_readers

    for read in find_readers(text):
        known = read(text, str(path))
        if known is None:
            continue
        if not camera and (len(known) == 1 or "cam0" in known):
            return next(iter(known.values()))()
        if camera in known:
            return known[camera]()
        problem = f"{path} has no camera '{camera}'" if camera else f"{path} has several cameras"
        raise CameraError(f"{problem}: select one of {', '.join(known)}, such as "
                          f"{path}#{next(iter(known))}")
    return None


def split_name(name: str | Path) -> tuple[Path, str]:
    """Split `path#camera` into path and camera; the camera may be missing.

    If a file with a # in its name exists, the whole name is the path.
    """
    path = Path(name).expanduser()
    if "#" not in path.name or path.is_file():
        return path, ""
    stem, _, camera = path.name.rpartition("#")
    return path.with_name(stem), camera
