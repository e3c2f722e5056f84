"""Readers of files that describe a camera: presets and calibrations.

A preset is a YAML file with settings of CameraConfig. It may name a calibration file with the key
`calibration`, and contain further settings.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from aras_visual_servo_base.yaml_files import parse_yaml, read_text

from ..errors import CameraError
from .calibration_loader import CALIBRATION_KEY as CALIBRATION
from .calibration_loader import apply_calibration, find_calibration, split_name
from .config import CameraConfig


def read_camera(name: str | Path) -> dict[str, Any]:
    """Read the settings of a camera from a preset or a calibration file.

    Args:
        name: path of the file, or `path#camera` for one of several cameras in a calibration.

    Raises:
        CameraError: the message names the file, the field and the valid values.
    """
    path, camera = split_name(name)
    text = read_text(path, CameraError)
    calibration = None if _is_preset(text) else find_calibration(text, path, camera)
    if calibration is not None:
        if calibration.width is None or calibration.height is None:
            raise CameraError(
                f"{path}: image_width and image_height are missing: add them, or write a preset "
                f"with width, height (px) and 'calibration: {name}'"
            )
        return calibration.to_settings()
    settings = parse_yaml(text, str(path), CameraError)
    if not isinstance(settings, Mapping):
        raise CameraError(f"{path} contains no mapping of keys to values, so it is neither a "
                          "camera preset nor a calibration: give another file")
    if camera:
        raise CameraError(f"{path} is a preset, which has only one camera: remove '#{camera}'")
    found = apply_calibration(settings, path.parent)
    CameraConfig.check_keys(found, f"{path}: ")
    return found


def _is_preset(text: str) -> bool:
    """Return whether a text is a preset: it has only keys of CameraConfig, and no matrix with rows.
    """
    try:
        settings = parse_yaml(text, "", CameraError)
    except CameraError:
        return False
    if not isinstance(settings, Mapping) or not settings:
        return False
    rows = any(isinstance(one, Mapping) and ("rows" in one or "data" in one)
               for one in settings.values())  # fmt: skip
    return not rows and settings.keys() <= {CALIBRATION, *CameraConfig.__dataclass_fields__}
