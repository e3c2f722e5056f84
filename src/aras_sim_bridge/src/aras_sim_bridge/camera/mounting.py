"""Where cameras sit: on a link of a model or fixed in the world, and the settings laid over them.

Settings come as a nested mapping, as /gazebo/cameras on the parameter server gives it: the parts of
a camera's name lead to its settings, whose keys are CameraConfig's. A mapping with the key `parent`
is a camera of its own, fixed in the world.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from aras_sim_bridge.camera import CameraConfig, CameraSensor, SensorFrame
from aras_sim_bridge.camera.config import FloatTriple, derive_seed
from aras_sim_bridge.description import CameraDescription
from aras_sim_bridge.errors import CameraError, RenderingError, SimError
from aras_sim_bridge.world import Model, Pose
from aras_visual_servo_base.camera_mounting import check_optical
from aras_visual_servo_base.hand_eye import read_hand_eye
from aras_visual_servo_base.poses import LENGTH_UNITS, inverse, optical_pose
from aras_visual_servo_base.setting_values import merge
from aras_visual_servo_base.settings import build, convert, parameter

T = TypeVar("T")


@dataclass(frozen=True)
class CameraPlacementEntry:
    """A pose as it may be written: xyz, m, and rpy about fixed axes, rad."""

    xyz: FloatTriple = (0.0, 0.0, 0.0)
    rpy: FloatTriple = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class HandEyeEntry:
    """A hand-eye calibration's file, and the units of its lengths; '': as the file says."""

    file: str
    units: str = parameter("", choices=("", *LENGTH_UNITS))


log = logging.getLogger(__name__)
HAND_EYE_KEY = "hand_eye"

WORLD = "world"


class MountedCamera:
    """A camera in its place. It draws while `enabled` and hands its frames to `on_frame`.

    model, link: what it sits on; None and 'world' for one that is fixed in the world.
    """

    def __init__(
        self, sensor: CameraSensor, model: Model | None, link: str, pose: Pose | None = None
    ) -> None:
        """`pose` is that of a camera fixed in the world; the others follow their link."""
        self.sensor = sensor
        self.model = model
        self.link = link
        self.on_frame: Callable[[SensorFrame], None] | None = None
        self._fixed = None if pose is None else pose.matrix()
        self._enabled = False
        self._is_new = False
        self._last_error = ""

    @property
    def enabled(self) -> bool:
        """Whether pictures are wanted; may be set from any thread."""
        return self._enabled

    @enabled.setter
    def enabled(self, enabled: bool) -> None:
        # Instants that passed while nobody looked are not made up for: that picture would show a
        # later world than its stamp says.
        if enabled and not self._enabled:
            self._is_new = True
        self._enabled = enabled

    @property
    def parent_T_optical(self) -> np.ndarray:
        """(4, 4) pose of the optical frame in the link, or in the world."""
        mounting = self.sensor.link_T_optical
        return mounting if self._fixed is None else self._fixed @ mounting

    @property
    def idle_until_ns(self) -> int:
        """Up to when, ns, steps may end without a look at the world."""
        return 0 if self._is_new else self.sensor.due_ns - 1

    def trigger(self, time_ns: int, step_ns: int) -> None:
        """Expose once in the coming step, where pictures are wanted; see CameraSensor.trigger."""
        self._refresh(time_ns)
        if self._enabled:
            self.sensor.trigger(time_ns, step_ns)

    def _refresh(self, time_ns: int) -> None:
        if self._is_new:
            self._is_new = False
            self.sensor.reset(time_ns)

    def before_step(self, time_ns: int, after_ns: int) -> None:
        """Remember the world where an exposure falls between two ticks."""
        self._refresh(time_ns)
        if self.sensor.needs_previous_pose(after_ns):
            self._attempt(self.sensor.before_step, time_ns)

    def after_step(self, time_ns: int) -> None:
        """Expose and deliver; for steps after which the sensor is due."""
        frame = self._attempt(self.sensor.capture, time_ns)
        if frame is not None and self.on_frame is not None:
            self.on_frame(frame)

    def _attempt(self, draw: Callable[[np.ndarray, int], T], time_ns: int) -> T | None:
        """Draw. A frame that cannot be drawn is left out, with a log line for each new reason: one
        unreadable mesh must not end the simulation."""
        try:
            drawn = draw(self._read_pose(), time_ns)
        except (RenderingError, MemoryError) as error:
            self.sensor.reset(time_ns)
            reason = str(error) or "not enough memory; make width and height smaller"
            if reason != self._last_error:
                log.error("camera '%s' gives no pictures: %s", self.sensor.config.name, reason)
            self._last_error = reason
            return None
        if self._last_error and drawn is not None:
            log.info("camera '%s' gives pictures again", self.sensor.config.name)
            self._last_error = ""
        return drawn

    def _read_pose(self) -> np.ndarray:
        if self.model is None:
            return self._fixed
        return self.model.link_pose(self.link).matrix()


def find_simultaneous(
    camera: MountedCamera, cameras: Iterable[MountedCamera]
) -> list[MountedCamera]:
    """Those that expose together with `camera`, itself among them."""
    shutter = camera.sensor.config.shutter
    return [other for other in cameras if other is camera or shutter
            and other.model is camera.model and other.sensor.config.shutter == shutter]


def configure_robot_camera(camera: CameraDescription, settings: Mapping[str, object],
                 defaults: Mapping[str, object], seed: int) -> CameraConfig:
    """Config of a description's camera with the settings of its name laid over it.

    Raises CameraError naming the key that is wrong.
    """
    name = camera.plugin.camera_name if camera.plugin is not None else ""
    name = name or camera.name
    own = find_settings(settings, name)
    for key in ("parent", "pose"):
        if key in own:
            raise CameraError(
                f"camera '{name}': '{key}' is for cameras with 'parent: world'; one on a robot is "
                "moved in its link by 'xyz' and 'rpy'"
            )
    _check_link(own, name)
    try:
        return CameraConfig.from_description(
            camera, merge({"seed": derive_seed(seed, name), **defaults}, own)
        )
    except CameraError as error:
        if not own:
            raise
        raise CameraError(f"{error} (its settings are those of '{name}')") from None


def configure_world_camera(
    name: str, settings: Mapping[str, object], defaults: Mapping[str, object], seed: int
) -> tuple[CameraConfig, Pose]:
    """Config and pose of a camera fixed in the world; the sensor looks along the pose's +x, z up.

    pose: [x, y, z, roll, pitch, yaw] or {xyz: [...], rpy: [...]}, m and rad. hand_eye, instead of
    it: path of a hand-eye calibration, or {file: path, units: m, cm or mm}; the file says where the
    optical frame is in the world.

    Raises CameraError naming the key that is wrong.
    """
    placed = ("parent", "pose", HAND_EYE_KEY)
    own = {key: value for key, value in settings.items() if key not in placed}
    if settings.get("parent") != WORLD:
        raise CameraError(
            f"camera '{name}': parent {settings.get('parent')!r} is not known; 'world' is the one "
            "there is, cameras on robots belong into their URDF"
        )
    _check_link(own, name)
    if HAND_EYE_KEY not in settings:
        pose = _read_pose(settings.get("pose"), name)
    elif "pose" in settings:
        raise CameraError(
            f"camera '{name}': pose and {HAND_EYE_KEY} both say where it is; leave one of them out"
        )
    else:
        pose = _read_hand_eye_pose(settings[HAND_EYE_KEY], f"camera '{name}': {HAND_EYE_KEY}")
    frame = name.replace("/", "_") + "_optical_frame"
    values = {"name": name, "camera_name": name, "link": WORLD, "optical_frame_name": frame}
    values = merge({**values, "seed": derive_seed(seed, name), **defaults}, own)
    return CameraConfig.from_mapping(values), pose


def find_world_cameras(
    settings: Mapping[str, object],
) -> Iterator[tuple[str, Mapping[str, object]]]:
    """Name and settings of every camera that is no robot's."""
    for name, node in _list_mappings(settings, ""):
        if "parent" in node:
            yield name, node


def find_settings(settings: Mapping[str, object], name: str) -> Mapping[str, object]:
    """The settings at 'a/b' of a nested mapping; empty where there are none.

    Raises CameraError where something else than settings stands there.
    """
    node: object = settings
    for part in name.strip("/").split("/"):
        if part not in node:
            return {}
        node = node[part]
        if not isinstance(node, Mapping):
            raise CameraError(
                f"camera '{name}': its settings are {node!r} instead of keys with values"
            )
    return node


def find_unused_names(settings: Mapping[str, object], names: set[str]) -> list[str]:
    """Names in the settings that hold keys but belong to none of the cameras `names`."""
    return [
        path
        for path, node in _list_mappings(settings, "")
        if "parent" not in node and not any(f"{path}/".startswith(f"{name}/") for name in names)
    ]


def _list_mappings(node: object, path: str) -> Iterator[tuple[str, Mapping[str, object]]]:
    """Every mapping that can be a camera's settings, from the outside in; not those inside one."""
    if not isinstance(node, Mapping):
        return
    if path and ("parent" in node or any(not isinstance(v, Mapping) for v in node.values())):
        yield path, node
        return
    for key, child in node.items():
        yield from _list_mappings(child, f"{path}/{key}".lstrip("/"))


def _check_link(own: Mapping[str, object], name: str) -> None:
    if "link" in own:
        raise CameraError(
            f"camera '{name}': 'link' {own['link']!r} cannot be set: a camera sits where its URDF "
            "has it, or with 'parent: world' in the world; leave the key out"
        )


def _read_hand_eye_pose(value: object, where: str) -> Pose:
    """The pose of a fixed camera by a hand-eye calibration's file."""
    given = value if isinstance(value, Mapping) else {"file": value}
    entry = build(HandEyeEntry, given, where, CameraError)
    try:
        found = read_hand_eye(entry.file, entry.units)
        check_optical(found)
    except SimError as error:
        raise CameraError(f"{where}: {error}") from None
    return Pose.from_matrix(found.link_T_camera @ inverse(optical_pose(np.eye(4))))


def _read_pose(value: object, name: str) -> Pose:
    where = f"camera '{name}': pose"
    if isinstance(value, Mapping):
        pose = build(CameraPlacementEntry, value, where, CameraError)
        return Pose.from_rpy(pose.xyz, pose.rpy)
    wanted = {"expected": "[x, y, z, roll, pitch, yaw] in m and rad"}
    numbers = convert(value, tuple[(float,) * 6], where, CameraError, wanted)
    return Pose.from_rpy(numbers[:3], numbers[3:])
