"""Mounting of cameras on links or in the world, and the settings of these cameras.

The settings of all cameras are a nested mapping, such as /gazebo/cameras on the parameter server.
The camera name 'a/b' stands for the mapping settings['a']['b'], whose keys are fields of
CameraConfig. Settings with the key `parent` define a camera that is fixed in the world; other
settings change a camera of a robot description.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from aras_sim_bridge.camera import CameraConfig, CameraReading, CameraSensor
from aras_sim_bridge.camera.config import FloatTriple, derive_seed
from aras_sim_bridge.description import CameraDescription
from aras_sim_bridge.errors import CameraError, RenderingError, SimError
from aras_sim_bridge.world import Model, Pose
from aras_visual_servo_base.hand_eye_files import read_hand_eye
from aras_visual_servo_base.poses import LENGTH_UNITS, inverse, optical_pose
from aras_visual_servo_base.setting_values import merge
from aras_visual_servo_base.settings import build, convert, parameter
from aras_visual_servo_base.urdf_changes import check_optical

T = TypeVar("T")


@dataclass(frozen=True)
class CameraPlacementEntry:
    """Pose of a camera in its settings: position xyz (m), and rpy about fixed axes (rad)."""

    xyz: FloatTriple = (0.0, 0.0, 0.0)
    rpy: FloatTriple = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class HandEyeEntry:
    """File of a hand-eye calibration, and its unit of length; '' for the unit in the file."""

    file: str
    units: str = parameter("", choices=("", *LENGTH_UNITS))


log = logging.getLogger(__name__)
HAND_EYE_KEY = "hand_eye"

WORLD = "world"


class MountedCamera:
    """Camera on a link or in the world, which passes its frames to `on_frame` while enabled.

    Attributes:
        sensor: sensor of the camera.
        model, link: model and link on which the camera is mounted; None and 'world' for a camera
            that is fixed in the world.
        on_frame: function that is called with each frame; None if there is no receiver.
    """

    def __init__(
        self, sensor: CameraSensor, model: Model | None, link: str, pose: Pose | None = None
    ) -> None:
        """Mount a sensor. `pose` is the pose of a camera that is fixed in the world."""
        self.sensor = sensor
        self.model = model
        self.link = link
        self.on_frame: Callable[[CameraReading], None] | None = None
        self._fixed = None if pose is None else pose.matrix()
        self._enabled = False
        self._is_new = False
        self._last_error = ""

    @property
    def enabled(self) -> bool:
        """Whether the camera takes images. Any thread may set this."""
        return self._enabled

    @enabled.setter
    def enabled(self, enabled: bool) -> None:
        # Skip exposures that were due while the camera was disabled: images rendered now would not
        # show the world at the times of these exposures.
        if enabled and not self._enabled:
            self._is_new = True
        self._enabled = enabled

    @property
    def parent_T_optical(self) -> np.ndarray:
        """Pose (4, 4) of the optical frame in the link or in the world."""
        mounting = self.sensor.link_T_optical
        return mounting if self._fixed is None else self._fixed @ mounting

    @property
    def idle_until_ns(self) -> int:
        """Simulated time, ns, until which the camera needs neither `before_step` nor `after_step`.
        """
        return 0 if self._is_new else self.sensor.due_ns - 1

    def trigger(self, time_ns: int, step_ns: int) -> None:
        """If the camera is enabled, expose once in the next step; see CameraSensor.trigger."""
        if self._is_new:
            self._refresh(time_ns)
        if self._enabled:
            self.sensor.trigger(time_ns, step_ns)

    def adopt_rate(self, cameras: Iterable[MountedCamera], time_ns: int, step_ns: int) -> None:
        """Adopt the rate of the first of `cameras` with the same shutter; warn if it differs."""
        first = find_simultaneous(self, cameras)[0].sensor
        if self.sensor.rate != first.rate:
            log.warning(
                "camera '%s' has the same shutter as camera '%s', so it exposes at that camera's "
                "%g Hz instead of %g Hz; set the same update_rate for both",
                self.sensor.config.name, first.config.name, first.rate, self.sensor.rate,
            )
            self.sensor.set_rate(first.rate, time_ns, step_ns)

    def _refresh(self, time_ns: int) -> None:
        self._is_new = False
        self.sensor.reset(time_ns)

    def before_step(self, time_ns: int, after_ns: int) -> None:
        """Store the poses of the camera and the models if an exposure is due in the next step.

        The next physics step is from `time_ns` to `after_ns`.
        """
        if self._is_new:
            self._refresh(time_ns)
        if self.sensor.needs_previous_pose(after_ns):
            self._attempt(self.sensor.before_step, time_ns)

    def after_step(self, time_ns: int) -> None:
        """Expose and deliver frames. This is called after each step in which an image is due."""
        frame = self._attempt(self.sensor.capture, time_ns)
        if frame is not None and self.on_frame is not None:
            self.on_frame(frame)

    def _attempt(self, draw: Callable[[np.ndarray, int], T], time_ns: int) -> T | None:
        """Call `draw` with the camera's pose and `time_ns`, and return its result.

        If it fails, skip the frame, log the reason unless it was logged before, and return None.
        The simulation must not end because a single mesh cannot be read.
        """
        try:
            drawn = draw(self._read_pose(), time_ns)
        except (RenderingError, MemoryError) as error:
            self.sensor.reset(time_ns)
            reason = str(error) or "not enough memory; make width and height smaller"
            if reason != self._last_error:
                log.error("camera '%s' delivers no images: %s", self.sensor.config.name, reason)
            self._last_error = reason
            return None
        if self._last_error and drawn is not None:
            log.info("camera '%s' delivers images again", self.sensor.config.name)
            self._last_error = ""
        return drawn

    def _read_pose(self) -> np.ndarray:
        if self.model is None:
            return self._fixed
        return self.model.link_pose(self.link).matrix()


def check_names(config: CameraConfig, cameras: Iterable[MountedCamera]) -> None:
    """Raise CameraError if a camera already uses one of the ROS names of a new camera."""
    for camera in cameras:
        taken = config.names & camera.sensor.config.names
        if taken:
            owner = f" of model '{camera.model.name}'" if camera.model is not None else ""
            raise CameraError(
                f"camera '{config.name}' cannot use the ROS name {min(taken)}, because camera "
                f"'{camera.sensor.config.name}'{owner} uses it; change cameraName or "
                "robotNamespace of one camera"
            )


def find_simultaneous(
    camera: MountedCamera, cameras: Iterable[MountedCamera]
) -> list[MountedCamera]:
    """Return the cameras that expose together with `camera`, including `camera` itself."""
    shutter = camera.sensor.config.shutter
    return [other for other in cameras if other is camera or shutter
            and other.model is camera.model and other.sensor.config.shutter == shutter]


def configure_robot_camera(camera: CameraDescription, settings: Mapping[str, object],
                 defaults: Mapping[str, object], seed: int) -> CameraConfig:
    """Return the configuration of a camera that a robot description contains.

    Args:
        camera: camera of the description.
        settings: settings of all cameras by name; those for this camera override its description.
        defaults: fields of CameraConfig that override the description, unless `settings` set them.
        seed: seed of the simulation, from which the camera's default seed is derived.

    Raises:
        CameraError: the message names the wrong key.
    """
    name = camera.plugin.camera_name if camera.plugin is not None else ""
    name = name or camera.name
    own = find_settings(settings, name)
    for key in ("parent", "pose"):
        if key in own:
            raise CameraError(
                f"camera '{name}': '{key}' is only for cameras with 'parent: world'; use 'xyz' and "
                "'rpy' to move a camera in its link"
            )
    _check_link(own, name)
    try:
        return CameraConfig.from_description(
            camera, merge({"seed": derive_seed(seed, name), **defaults}, own)
        )
    except CameraError as error:
        if not own:
            raise
        raise CameraError(f"{error} (in the settings of camera '{name}')") from None


def configure_world_camera(
    name: str, settings: Mapping[str, object], defaults: Mapping[str, object], seed: int
) -> tuple[CameraConfig, Pose]:
    """Return the configuration and the pose of a camera that is fixed in the world.

    The settings contain one of two keys for the pose. `pose` is the pose of the sensor (x forward,
    z up), as [x, y, z, roll, pitch, yaw] or {xyz: [...], rpy: [...]}, in m and rad. `hand_eye` is a
    hand-eye calibration with the pose of the optical frame in the world, as the path of its file or
    {file: path, units: m, cm or mm}.

    Raises:
        CameraError: the message names the wrong key.
    """
    pose_keys = ("parent", "pose", HAND_EYE_KEY)
    own = {key: value for key, value in settings.items() if key not in pose_keys}
    if settings.get("parent") != WORLD:
        raise CameraError(
            f"camera '{name}': parent is {settings.get('parent')!r}, must be 'world'; define "
            "cameras on a robot in its URDF"
        )
    _check_link(own, name)
    if HAND_EYE_KEY not in settings:
        pose = _read_pose(settings.get("pose"), name)
    elif "pose" in settings:
        raise CameraError(
            f"camera '{name}': pose and {HAND_EYE_KEY} both define the camera's pose; remove one"
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
    """Yield the name and the settings of every camera that is fixed in the world."""
    for name, node in _list_mappings(settings, ""):
        if "parent" in node:
            yield name, node


def find_settings(settings: Mapping[str, object], name: str) -> Mapping[str, object]:
    """Return the settings of the camera `name`; an empty mapping if there are none.

    Raises:
        CameraError: the settings are not a mapping.
    """
    node: object = settings
    for part in name.strip("/").split("/"):
        if part not in node:
            return {}
        node = node[part]
        if not isinstance(node, Mapping):
            raise CameraError(
                f"camera '{name}': its settings are {node!r}, must be a mapping"
            )
    return node


def find_unused_names(settings: Mapping[str, object], names: set[str]) -> list[str]:
    """Return the camera names in `settings` that are not among the existing cameras, `names`.

    Settings with the key `parent` are left out, because they create a new camera.
    """
    return [
        path
        for path, node in _list_mappings(settings, "")
        if "parent" not in node and not any(f"{path}/".startswith(f"{name}/") for name in names)
    ]


def _list_mappings(node: object, path: str) -> Iterator[tuple[str, Mapping[str, object]]]:
    """Yield the path (such as 'a/b') and the settings of each possible camera in nested settings.

    `node` is the mapping at `path`. A mapping is a camera's settings if it contains the key
    `parent` or any value that is not a mapping. Its own values are not searched.
    """
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
            f"camera '{name}': 'link' {own['link']!r} cannot be set, because the URDF or "
            "'parent: world' determines where a camera is mounted; remove the key"
        )


def _read_hand_eye_pose(value: object, where: str) -> Pose:
    """Read the pose of a fixed camera from the file of a hand-eye calibration."""
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
    options = {"expected": "[x, y, z, roll, pitch, yaw] in m and rad"}
    numbers = convert(value, tuple[(float,) * 6], where, CameraError, options)
    return Pose.from_rpy(numbers[:3], numbers[3:])
