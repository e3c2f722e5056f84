"""Initial poses: by name, as joints, or as poses of the camera."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from aras_visual_servo_base.poses import transform

from ..arm import Arm
from ..errors import ConfigurationError, UnreachableError
from ..setting_kinds import is_number, suggestion, yaml_mapping

NONE = "none"


def start_joints(start: Any, arm: Arm, package: Path) -> np.ndarray | None:
    """Joints (n,) of a start, or None for 'none': servo from wherever the arm stands.

    Args:
        start: 'none', a name of config/starts.yaml, n numbers (a list, or words in a string),
            numbers by joint name, or {xyz, rpy} of the camera in the arm's base.
        arm: whose joints they are.
        package: directory of this package.

    Raises:
        ConfigurationError: an unknown name, a wrong count, a joint that the arm has not, a pose
            out of its reach.
    """
    if isinstance(start, str):
        words = start.replace(",", " ").strip("[] ").split()
        if len(words) > 1:
            start = [_number(word, start) for word in words]
        elif start == NONE:
            return None
        else:
            return _named(start, arm, package)
    if isinstance(start, Mapping):
        if set(start) == {"xyz", "rpy"}:
            return _of_pose(start, arm)
        return _by_joint(start, arm, f"{dict(start)}")
    if not (
        isinstance(start, list | tuple)
        and len(start) == len(arm.names)
        and all(is_number(value) for value in start)
    ):
        raise ConfigurationError(
            f"parameter ~start is {start!r}, must be a name, none, {{xyz, rpy}} of the camera, or "
            f"a finite number for each of {', '.join(arm.names)}"
        )
    return np.array(start, float)


def _named(name: str, arm: Arm, package: Path) -> np.ndarray:
    known = yaml_mapping(package / "config" / "starts.yaml")
    if name not in known:
        raise ConfigurationError(
            f"parameter ~start is '{name}': {suggestion(name, [*known, NONE])} (or a number for "
            f"each of {', '.join(arm.names)})"
        )
    return _by_joint(known[name], arm, name)


def _by_joint(values: Mapping[str, Any], arm: Arm, name: str) -> np.ndarray:
    for joint, value in values.items():
        if joint not in arm.names:
            raise ConfigurationError(
                f"parameter ~start is '{name}', which says where {joint} is: this arm's joints are "
                f"{', '.join(arm.names)}; give theirs, or none"
            )
        if not is_number(value):
            raise ConfigurationError(f"parameter ~start: {joint} is {value!r}, must be a number")
    missing = [joint for joint in arm.names if joint not in values]
    if missing:
        raise ConfigurationError(
            f"parameter ~start is '{name}', which says nothing of {', '.join(missing)}"
        )
    return np.array([values[joint] for joint in arm.names], float)


def _of_pose(pose: Mapping[str, Any], arm: Arm) -> np.ndarray:
    for key in ("xyz", "rpy"):
        value = pose[key]
        if not (isinstance(value, list | tuple) and len(value) == 3 and all(map(is_number, value))):
            raise ConfigurationError(f"parameter ~start: {key} is {value!r}, must be three numbers")
    middle = np.clip(0.0, arm.lower, arm.upper)
    try:
        return arm.inverse(transform(pose["xyz"], pose["rpy"]), middle)
    except UnreachableError as error:
        raise ConfigurationError(f"parameter ~start: {error}") from error


def _number(word: str, start: str) -> float:
    try:
        return float(word)
    except ValueError as error:
        raise ConfigurationError(
            f"parameter ~start is '{start}': '{word}' is no number"
        ) from error
