"""Reading and writing of goal files.

    joints: {J1: 0.0, J2: 0.0}                   # by name, rad or m
    camera_pose: {xyz: [...], rpy: [...]}        # base_T_camera, the optical frame
    depth: 0.1917                                # depth of the target's plane, m
    plane: [0.0, 0.0, 5.2]                       # 1/Z = A x + B y + C, 1/m; default: horizontal
    moments: {order: 6, m: [...], mu: [...]}     # normalised coordinates, as in ImageMoments
    kernel: {width: 320, height: 240, K: [9 numbers], features: [4 numbers]}
    camera: {width: 320, height: 240, K: [9 numbers], D: [], model: plumb_bob}
    features: {points: {...}}                    # taught data of each feature, by name
    target: {surface: 0.5905, ground: 0.59, boxes: [[low, high], ...]}   # if it is known
    mounting: {xyz: [...], rpy: [...]}           # pose of the camera on its link
    marker: DICT_APRILTAG_36h11:0                # marker that is the target
    camera_name: left                            # name of the control camera
    cameras: {right: {camera_pose: ..., plane: ..., moments: ..., camera: ...}}   # other cameras

Every key is checked. Each error message is a single line.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import yaml

from aras_visual_servo_base.poses import matrix_from_xyz_rpy, xyz_rpy_from_matrix
from aras_visual_servo_base.settings import build, parameter
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.moments import MAX_ORDER, Moments, Pinhole

from ..errors import ConfigurationError
from ..observation.feature_observer import explain_implausible
from ..observation.observation import CAMERA, Observation
from ..observation.target_geometry import TargetGeometry
from .starts import PoseEntry, ThreeNumbers

# The camera views the target's plane edge-on if the cosine of the angle between the optical axis
# and the plane's normal is below this. Then the target is not visible.
EDGE_ON_COSINE = 0.05
MIN_DEPTH, MAX_DEPTH = 1e-3, 100.0  # smallest and largest distance between target and camera, m
Matrix = tuple[float, float, float, float, float, float, float, float, float]


@dataclass(frozen=True, eq=False)
class GoalKernel:
    """Kernel features (4,) at the goal, measured by a camera with the intrinsic matrix K (3, 3)."""

    width: int
    height: int
    K: np.ndarray
    features: np.ndarray

    @classmethod
    def from_observation(cls, observation: Observation) -> GoalKernel | None:
        """Return the kernel features of an observation; None if it has none."""
        if observation.kernel is None:
            return None
        camera, features = observation.camera, np.array(observation.kernel[16:])
        return cls(camera.width, camera.height, np.reshape(camera.K, (3, 3)), features)

    def predict(self, outline: np.ndarray) -> GoalKernel:
        """Compute the kernel features of the same camera for an outline (n, 2), normalised."""
        from aras_visual_servo_camera.kernel import compute_outline_kernel_features

        found = compute_outline_kernel_features(
            outline, Pinhole.from_K(self.K), self.width, self.height
        )
        return replace(self, features=found.values)


@dataclass(frozen=True)
class MomentsEntry:
    """Moments in a goal file, in normalised coordinates."""

    order: int = parameter(least=1, most=MAX_ORDER)
    m: tuple[float, ...] = parameter()
    mu: tuple[float, ...] = parameter()


@dataclass(frozen=True)
class KernelEntry:
    """Kernel features in a goal file; K is the intrinsic matrix, row by row, px."""

    width: int
    height: int
    K: Matrix
    features: tuple[float, float, float, float]


@dataclass(frozen=True)
class GoalEntries:
    """Entries of a goal file; the docstring of this module describes them."""

    renamed_keys = {"seen_by": "camera_name"}

    joints: Mapping[str, float] | None = None
    camera_pose: PoseEntry | None = None
    depth: float | None = parameter(None, "m: is it in metres?", least=MIN_DEPTH, most=MAX_DEPTH)
    plane: ThreeNumbers | None = None
    moments: MomentsEntry | None = None
    kernel: KernelEntry | None = None
    camera: CameraModel | None = None
    features: Mapping[str, Mapping[str, Any]] | None = None
    target: Mapping[str, Any] | None = None
    mounting: PoseEntry | None = None
    marker: str = ""
    camera_name: str = CAMERA
    cameras: Mapping[str, Mapping[str, Any]] | None = None


def read_goal_fields(data: Any, name: str) -> dict[str, Any]:
    """Read the fields of a Goal, except its name, from a mapping that was read from YAML."""
    try:
        entries = build(GoalEntries, data, f"{name}: ", ConfigurationError)
    except VisionError as error:  # the camera model raises a VisionError for invalid parameters
        raise ConfigurationError(f"{name}: {error}") from error
    target = entries.target
    return {
        "joints": dict(entries.joints or {}),
        "world_T_camera": _read_pose(entries.camera_pose),
        "depth": entries.depth,
        "plane": _read_plane(entries.plane, name),
        "moments": _read_moments(entries.moments, name),
        "kernel": _read_kernel(entries.kernel),
        "camera": entries.camera,
        "features": {key: dict(taught) for key, taught in (entries.features or {}).items()},
        "target": None if target is None else TargetGeometry.from_mapping(
            target, f"{name}: target"
        ),
        "mounting": _read_pose(entries.mounting),
        "marker": _read_marker(entries.marker, name),
        "camera_name": entries.camera_name,
    }


def _read_marker(entry: str, name: str) -> str:
    if not entry:
        return entry
    from aras_visual_servo_camera.markers import MarkerChoice

    try:
        MarkerChoice.read(entry, f"{name}: marker")
    except VisionError as error:
        raise ConfigurationError(str(error)) from None
    return entry


def _read_plane(entry: ThreeNumbers | None, name: str) -> Plane | None:
    if entry is None:
        return None
    plane = Plane(*entry)
    if not 1.0 / MAX_DEPTH <= plane.C <= 1.0 / MIN_DEPTH:
        raise ConfigurationError(
            f"{name}: C, the last number of plane, is {plane.C:g}, must be 1/Z of a target "
            f"{MIN_DEPTH:g} to {MAX_DEPTH:g} m in front of the camera"
        )
    if plane.C / math.hypot(*plane) < EDGE_ON_COSINE:
        raise ConfigurationError(
            f"{name}: the camera looks parallel to plane, {list(plane)}; give the coefficients "
            "A, B, C of 1/Z = A x + B y + C of the target's plane"
        )
    return plane


def _read_pose(entry: PoseEntry | None) -> np.ndarray | None:
    return None if entry is None else matrix_from_xyz_rpy(entry.xyz, entry.rpy)


def _read_moments(entry: MomentsEntry | None, name: str) -> Moments | None:
    if entry is None:
        return None
    count = (entry.order + 1) * (entry.order + 2) // 2
    for key in ("m", "mu"):
        if len(getattr(entry, key)) != count:
            raise ConfigurationError(f"{name}: moments.{key} must be {count} finite numbers")
    try:
        moments = Moments.from_arrays(np.array(entry.m), np.array(entry.mu), entry.order)
    except VisionError as error:
        raise ConfigurationError(f"{name}: {error}") from error
    if fault := explain_implausible(moments):
        raise ConfigurationError(f"{name}: {fault}")
    return moments


def _read_kernel(entry: KernelEntry | None) -> GoalKernel | None:
    if entry is None:
        return None
    K, features = np.array(entry.K).reshape(3, 3), np.array(entry.features)
    for array in (K, features):
        array.setflags(write=False)
    return GoalKernel(entry.width, entry.height, K, features)


def write_goal_text(attributes: Mapping[str, Any], heading: str) -> str:
    """Return the text of a goal file, with `heading` as a comment; empty entries are omitted.

    attributes: attributes of the Goal; `other_cameras` has such a mapping for each camera.
    """
    comment = "".join(f"# {line}\n" for line in heading.splitlines())
    return comment + yaml.safe_dump(_make_entries(attributes), sort_keys=False)


def _make_entries(goal: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries of a goal's file that are not empty."""
    others = goal["other_cameras"]
    entries = {
        "joints": goal["joints"],
        "camera_pose": _make_pose_entry(goal["world_T_camera"]),
        "depth": goal["depth"],
        "plane": goal["plane"],
        "moments": goal["moments"],
        "kernel": goal["kernel"],
        "camera": goal["camera"],
        "features": goal["features"],
        "target": None if goal["target"] is None else goal["target"].to_mapping(),
        "mounting": _make_pose_entry(goal["mounting"]),
        "marker": goal["marker"] or None,
        "camera_name": goal["camera_name"] if others else None,
        "cameras": {name: _make_entries(other) for name, other in others.items()},
    }
    plain = _to_plain_values(entries)
    return {name: value for name, value in plain.items() if value not in (None, {})}


def _to_plain_values(value: Any) -> Any:
    """Convert the parts of a goal to numbers, lists and dicts for YAML."""
    if isinstance(value, Moments):
        value = {"order": value.order, "m": value.m_array, "mu": value.mu_array}
    elif isinstance(value, GoalKernel):
        value = {**vars(value), "K": np.ravel(value.K)}
    elif isinstance(value, CameraModel):
        value = {name: getattr(value, name) for name in ("width", "height", "K", "D", "model")}
    if isinstance(value, Mapping):
        return {name: _to_plain_values(inner) for name, inner in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return (
        [_to_plain_values(inner) for inner in value] if isinstance(value, list | tuple) else value
    )


def _make_pose_entry(a_T_b: np.ndarray | None) -> dict[str, list[float]] | None:
    """Return a pose (4, 4) as an entry of a goal file."""
    return (
        None
        if a_T_b is None
        else dict(zip(("xyz", "rpy"), xyz_rpy_from_matrix(a_T_b), strict=True))
    )
