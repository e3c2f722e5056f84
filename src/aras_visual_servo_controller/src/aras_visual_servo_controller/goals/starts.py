"""Start poses of a run: by name, as joints, or as poses of the camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_base.settings import build, convert
from aras_visual_servo_base.yaml_files import read_yaml

from ..errors import ConfigurationError, UnreachableError
from ..kinematics import Arm

NONE = "none"
ThreeNumbers = tuple[float, float, float]


@dataclass(frozen=True)
class PoseEntry:
    """A pose in a file: xyz, m, and fixed-axis rpy, rad, as in a URDF."""

    xyz: ThreeNumbers
    rpy: ThreeNumbers


def find_start_joints(
    start: Any, arm: Arm, package: Path, near: np.ndarray | None = None
) -> np.ndarray | None:
    """Return the joints (n,) of a start pose.

    Return None for the start 'none': the run starts from the present joints.

    Args:
        start: 'none', a name of config/starts.yaml, n numbers (as a list or a string), numbers by
            joint name, or {xyz, rpy} of the camera in the arm's base.
        arm: arm whose joints are returned.
        package: directory of this package.
        near: joints (n,) from which the search for the joints of a pose starts. With the goal's
            joints, the start gets the same arm configuration (such as elbow up) as the goal. None
            to search from zero joints, moved into the limits.

    Raises:
        ConfigurationError: the name is unknown, the number of values is wrong, the arm does not
            have a joint, or the pose is out of its reach.
    """
    if isinstance(start, str):
        text = start.replace(",", " ").strip("[] ")
        if len(text.split()) > 1:
            start = _read_numbers(text, "parameter ~start")
        elif start == NONE:
            return None
        else:
            return _load_start(start, arm, package)
    if isinstance(start, Mapping):
        if set(start) == {"xyz", "rpy"}:
            return _solve_pose(start, arm, near)
        return _read_joints(start, arm, f"{dict(start)}")
    if not (isinstance(start, list | tuple) and len(start) == len(arm.names)):
        raise ConfigurationError(
            f"parameter ~start is {start!r}, must be a name, none, {{xyz, rpy}} of the camera, or "
            f"a finite number for each of {', '.join(arm.names)}"
        )
    return np.array(_read_numbers(start, "parameter ~start"))


def _load_start(name: str, arm: Arm, package: Path) -> np.ndarray:
    path = package / "config" / "starts.yaml"
    data = read_yaml(path, ConfigurationError)
    known = convert(data, Mapping[str, Mapping[str, float]], f"{path}: ", ConfigurationError)
    if name not in known:
        raise ConfigurationError(
            f"parameter ~start is '{name}': {suggest(name, [*known, NONE])} (or a number for "
            f"each of {', '.join(arm.names)})"
        )
    return _read_joints(known[name], arm, name)


def _read_joints(values: Mapping[str, Any], arm: Arm, name: str) -> np.ndarray:
    values = convert(values, Mapping[str, float], "parameter ~start", ConfigurationError)
    for joint in values:
        if joint not in arm.names:
            raise ConfigurationError(
                f"parameter ~start is '{name}', which has a value for {joint}: the joints of this "
                f"arm are {', '.join(arm.names)}; give values for these, or set ~start to none"
            )
    missing = [joint for joint in arm.names if joint not in values]
    if missing:
        raise ConfigurationError(
            f"parameter ~start is '{name}', which has no value for "
            f"{', '.join(missing)}: give a value for each joint"
        )
    return np.array([values[joint] for joint in arm.names])


def _solve_pose(entry: Mapping[str, Any], arm: Arm, near: np.ndarray | None) -> np.ndarray:
    pose = build(PoseEntry, entry, "parameter ~start", ConfigurationError)
    if near is None:
        near = np.clip(0.0, arm.lower, arm.upper)
    try:
        return arm.inverse_kinematics(matrix_from_xyz_rpy(pose.xyz, pose.rpy), near)
    except UnreachableError as error:
        raise ConfigurationError(f"parameter ~start: {error}") from error


def _read_numbers(values: Any, where: str) -> tuple[float, ...]:
    return convert(values, tuple[float, ...], where, ConfigurationError)
