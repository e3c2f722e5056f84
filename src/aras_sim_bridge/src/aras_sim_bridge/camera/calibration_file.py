"""Calibration files: detection of the format, and application to the settings of a camera.

The content, not the file name, determines the format:

- ROS: camera_info files of camera_calibration and `~/.ros/camera_info`, messages printed by
  rostopic, and .ini files of camera_calibration_parsers;
- OpenCV: FileStorage in YAML, XML or JSON;
- Kalibr: camchain files;
- ViSP: files of vpXmlParserCamera.

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
# Settings that `calibration` determines; other values for them are refused.
LENS_KEYS = ("width", "height", "camera_matrix", "horizontal_fov", "lens", "distortion_model",
           "distortion_coefficients", "rectification_matrix", "projection_matrix")  # fmt: skip


def apply_calibration(settings: Mapping[str, Any], folder: Path | None = None) -> dict[str, Any]:
    """Return the settings with their `calibration` replaced by the values that it contains.

    Args:
        settings: settings of a camera.
        folder: folder of relative paths; None if the path must be absolute.

    Raises:
        CameraError: see `find_calibration`; or a setting contradicts the calibration.
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
            raise CameraError(f"calibration '{name}' is a relative path: give the absolute one")
        path = folder / path
    found = find_calibration(read_text(path, CameraError), path, camera)
    if found is None:
            raise CameraError(f"{path} is not a calibration: its keys are those of a preset")
    rest = {key: value for key, value in settings.items() if key != CALIBRATION_KEY}
    given = found.to_settings()
    for key in LENS_KEYS:
        if key in rest and (key == "horizontal_fov" or key in given and rest[key] != given[key]):
            raise CameraError(
                f"{key} is {format_value(rest[key])}, but the calibration {path} has "
                f"{format_value(given.get(key, 'the camera matrix'))}: remove {key}"
            )
    return {**given, **rest}


def find_calibration(text: str, path: Path, camera: str) -> Calibration | None:
    """Return the calibration of one camera in a file's text; None if the text is not a calibration.
    """
    from .calibration_formats import FORMATS

    for detect, read in FORMATS:
        if not detect(text):
            continue
        known = read(text, str(path))
        if known is None:
            continue
        if not camera and (len(known) == 1 or "cam0" in known):  # Kalibr: the first of the chain
            return next(iter(known.values()))()
        if camera in known:
            return known[camera]()
        raise CameraError(
            f"{path} has the cameras {', '.join(known)}: select one, such as "
            f"{path}#{next(iter(known))}" + (f"; there is no '{camera}'" if camera else "")
        )
    return None


def split_name(name: str | Path) -> tuple[Path, str]:
    """Return path and camera of `path#camera`; an existing file with a # in its name has priority.
    """
    path = Path(name).expanduser()
    if "#" not in path.name or path.is_file():
        return path, ""
    stem, _, camera = path.name.rpartition("#")
    return path.with_name(stem), camera
