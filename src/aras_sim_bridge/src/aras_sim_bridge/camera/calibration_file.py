"""Files of calibrations: which format a file has, and a camera's settings with what it gives.

Formats are known by their content and not by the file's name:

- ROS: camera_info as camera_calibration and `~/.ros/camera_info` have it, a message printed by
  rostopic, and the .ini of camera_calibration_parsers;
- OpenCV: FileStorage in YAML, XML or JSON;
- Kalibr: a camchain;
- ViSP: vpXmlParserCamera.

`FILE#NAME` chooses one camera of several.
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
# Keys beside `calibration` that would contradict it.
LENS_KEYS = ("width", "height", "camera_matrix", "horizontal_fov", "lens", "distortion_model",
           "distortion_coefficients", "rectification_matrix", "projection_matrix")  # fmt: skip


def apply_calibration(settings: Mapping[str, Any], folder: Path | None = None) -> dict[str, Any]:
    """Settings with what their `calibration` gives in its place.

    Args:
        folder: that a relative path starts from; None: it has to be absolute.

    Raises:
        CameraError: see `find_calibration`; or a key that contradicts the calibration.
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
        raise CameraError(f"{path} is no calibration: its keys are those of a preset")
    rest = {key: value for key, value in settings.items() if key != CALIBRATION_KEY}
    given = found.to_settings()
    for key in LENS_KEYS:
        if key in rest and (key == "horizontal_fov" or key in given and rest[key] != given[key]):
            raise CameraError(
                f"{key} is {format_value(rest[key])}, and the calibration {path} says "
                f"{format_value(given.get(key, 'the camera matrix'))}: leave {key} out"
            )
    return {**given, **rest}


def find_calibration(text: str, path: Path, camera: str) -> Calibration | None:
    """What a calibration file says of one of its cameras; None: the text is of another kind."""
    from .calibration_formats import FORMATS

    for detect, read in FORMATS:
        if not detect(text):
            continue
        known = read(text, str(path))
        if known is None:
            continue
        if not camera and (len(known) == 1 or "cam0" in known):  # of a chain the first, by Kalibr
            return next(iter(known.values()))()
        if camera in known:
            return known[camera]()
        raise CameraError(
            f"{path} has the cameras {', '.join(known)}: name one, as "
            f"{path}#{next(iter(known))}" + (f", not '{camera}'" if camera else "")
        )
    return None


def split_name(name: str | Path) -> tuple[Path, str]:
    """Path and camera of `path#camera`; a file whose name has a # is meant where it is there."""
    path = Path(name).expanduser()
    if "#" not in path.name or path.is_file():
        return path, ""
    stem, _, camera = path.name.rpartition("#")
    return path.with_name(stem), camera
