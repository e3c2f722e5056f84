"""Reading of goal files: every key checked, one line for what is wrong."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from aras_visual_servo_base.poses import transform
from aras_visual_servo_camera.errors import VisionError
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_camera.moments import MAX_ORDER, Moments
from aras_visual_servo_camera.undistortion import CameraModel

from ..errors import ConfigurationError
from ..seeing.observation import implausible
from ..seeing.target_geometry import TargetGeometry
from .goal import EDGE_ON, KEYS, Goal, GoalKernel

NEAREST, FARTHEST = 1e-3, 100.0  # m that a target may be from the camera


def read_goal(data: Any, name: str) -> Goal:
    """A Goal of a mapping as YAML gives it; see Goal.from_mapping."""
    if not isinstance(data, Mapping):
        raise ConfigurationError(f"{name}: a goal is a mapping with the keys {', '.join(KEYS)}")
    for key in data:
        if key not in KEYS:
            near = difflib.get_close_matches(str(key), KEYS, 1)
            hint = f"did you mean '{near[0]}'?" if near else f"known are {', '.join(KEYS)}"
            raise ConfigurationError(f"{name}: unknown key '{key}': {hint}")
    depth = data.get("depth")
    if depth is not None:
        depth = float(numbers([depth], 1, f"{name}: 'depth'")[0])
        if not depth > 0.0:
            raise ConfigurationError(f"{name}: 'depth' is {depth}, it must be above 0 m")
        if not NEAREST <= depth <= FARTHEST:
            raise ConfigurationError(
                f"{name}: 'depth' is {depth:g}, it must be {NEAREST:g} to {FARTHEST:g} m: is it in "
                "metres?"
            )
    plane = data.get("plane")
    if plane is not None:
        plane = Plane(*numbers(plane, 3, f"{name}: 'plane'").tolist())
        if not 1.0 / FARTHEST <= plane.C <= 1.0 / NEAREST:
            raise ConfigurationError(
                f"{name}: 'plane' ends with {plane.C:g}, which must be 1/Z of a target {NEAREST:g} "
                f"to {FARTHEST:g} m before the camera"
            )
        if plane.C / math.hypot(*plane) < EDGE_ON:
            raise ConfigurationError(
                f"{name}: 'plane' is {list(plane)}: the camera looks along it, not on it"
            )
    features = data.get("features") or {}
    if not (
        isinstance(features, Mapping) and all(isinstance(v, Mapping) for v in features.values())
    ):
        raise ConfigurationError(f"{name}: 'features' must hold a mapping for each feature")
    target = data.get("target")
    return Goal(
        name=name,
        joints=_joints(data.get("joints") or {}, name),
        world_T_camera=_pose(data.get("camera_pose"), f"{name}: 'camera_pose'"),
        depth=depth,
        plane=plane,
        moments=_moments(data.get("moments"), name),
        kernel=_kernel(data.get("kernel"), name),
        camera=_camera(data.get("camera"), name),
        features=dict(features),
        target=None if target is None else TargetGeometry.from_mapping(target, f"{name}: 'target'"),
        mounting=_pose(data.get("mounting"), f"{name}: 'mounting'"),
    )


def numbers(values: Any, count: int, where: str) -> np.ndarray:
    """`count` finite numbers (count,), read-only.

    Raises:
        ConfigurationError: beginning with `where`.
    """
    wrong = ConfigurationError(f"{where} must be {count} finite number(s)")
    if not isinstance(values, list | tuple) or len(values) != count:
        raise wrong
    if any(isinstance(value, bool) or not isinstance(value, int | float) for value in values):
        raise wrong
    array = np.array(values, float)
    if not np.isfinite(array).all():
        raise wrong
    array.setflags(write=False)
    return array


def _joints(data: Any, name: str) -> dict[str, float]:
    if not isinstance(data, Mapping):
        raise ConfigurationError(f"{name}: 'joints' must be a mapping of joint names to numbers")
    return {
        str(joint): float(numbers([value], 1, f"{name}: joint '{joint}'")[0])
        for joint, value in data.items()
    }


def _pose(data: Any, where: str) -> np.ndarray | None:
    if data is None:
        return None
    if not isinstance(data, Mapping) or set(data) != {"xyz", "rpy"}:
        raise ConfigurationError(f"{where} must hold xyz (m) and rpy (rad)")
    return transform(*(numbers(data[key], 3, f"{where}, {key}") for key in ("xyz", "rpy")))


def _moments(data: Any, name: str) -> Moments | None:
    if data is None:
        return None
    if not isinstance(data, Mapping) or set(data) != {"order", "m", "mu"}:
        raise ConfigurationError(f"{name}: 'moments' must hold order, m and mu")
    order = data["order"]
    if isinstance(order, bool) or not isinstance(order, int) or not 1 <= order <= MAX_ORDER:
        raise ConfigurationError(f"{name}: the moments' order is {order!r}, 1 to {MAX_ORDER}")
    count = (order + 1) * (order + 2) // 2
    m, mu = (numbers(data[key], count, f"{name}: 'moments.{key}'") for key in ("m", "mu"))
    try:
        moments = Moments.from_arrays(m, mu, order)
    except VisionError as error:
        raise ConfigurationError(f"{name}: {error}") from error
    if fault := implausible(moments):
        raise ConfigurationError(f"{name}: {fault}")
    return moments


def _kernel(data: Any, name: str) -> GoalKernel | None:
    if data is None:
        return None
    if not isinstance(data, Mapping):
        raise ConfigurationError(f"{name}: 'kernel' must hold width, height, K and features")
    size = numbers([data.get("width"), data.get("height")], 2, f"{name}: 'kernel' width, height")
    return GoalKernel(
        width=int(size[0]),
        height=int(size[1]),
        K=numbers(data.get("K"), 9, f"{name}: 'kernel.K'").reshape(3, 3),
        features=numbers(data.get("features"), 4, f"{name}: 'kernel.features'"),
    )


def _camera(data: Any, name: str) -> CameraModel | None:
    if data is None:
        return None
    if not isinstance(data, Mapping):
        raise ConfigurationError(f"{name}: 'camera' must hold width, height, K, D and model")
    size = numbers([data.get("width"), data.get("height")], 2, f"{name}: 'camera' width, height")
    D = data.get("D") or []
    if not isinstance(D, list | tuple):
        raise ConfigurationError(f"{name}: 'camera.D' must be a list of numbers")
    try:
        return CameraModel(
            int(size[0]),
            int(size[1]),
            tuple(numbers(data.get("K"), 9, f"{name}: 'camera.K'").tolist()),
            tuple(numbers(D, len(D), f"{name}: 'camera.D'").tolist()),
            str(data.get("model", "plumb_bob")),
        )
    except VisionError as error:
        raise ConfigurationError(f"{name}: {error}") from error
