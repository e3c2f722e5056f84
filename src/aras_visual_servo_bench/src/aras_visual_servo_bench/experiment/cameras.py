"""Cameras of an experiment: what they truly are, and what the controller takes them for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from aras_sim_bridge.camera import CameraConfig
from aras_sim_bridge.camera.calibration_file import CALIBRATION_KEY as CALIBRATION
from aras_sim_bridge.camera.calibration_file import apply_calibration
from aras_sim_bridge.camera.camera_file import read_camera
from aras_sim_bridge.errors import CameraError
from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.poses import LENGTH_UNITS, inverse, matrix_from_xyz_rpy, optical_pose
from aras_visual_servo_base.setting_values import merge
from aras_visual_servo_base.settings import check, parameter
from aras_visual_servo_camera.errors import CalibrationError
from aras_visual_servo_camera.undistortion import CameraModel, subdivide
from aras_visual_servo_controller.observation.camera_rig import MAX_WAITING_IMAGES

from ..errors import ExperimentError, require
from ..targets.target_spec import PoseValues, TargetSpec
from .packages import PackagePath

if TYPE_CHECKING:
    from aras_visual_servo_base.hand_eye import HandEyeCalibration

HALF_TURN = 3.142  # rad; pi as rounded up in files
MAX_DELAY = 10.0  # s
PRESET_FOLDER = "config/cameras"
# the key that names one, and the one without a word
PRESET_KEY, DEFAULT_PRESET = "preset", "original"
NO_SETTINGS: Mapping[str, Any] = MappingProxyType({})
WORLD = "world"  # as the link of a hand-eye calibration: of a fixed camera
# grey levels of a drawn picture, as the renderer has table and target
WHITE_LEVEL, DARK_LEVEL = 255, 0


@dataclass(frozen=True)
class HandEyeSpec:
    """A file with the result of a hand-eye calibration; see aras_visual_servo_base.hand_eye.

    file: its path. units: of its lengths, m, cm or mm; '': as the file says, else metres.
    link: that carries the camera; '': as the file names it. WORLD: the camera is fixed, and the
        file says where it is in the world (the arm's base).
    """

    file: str = parameter(shorthand=True)
    units: str = parameter("", choices=("", *LENGTH_UNITS))
    link: str = ""

    def __post_init__(self) -> None:
        check(self, ExperimentError, "hand_eye")

    def read(self, packages: PackagePath) -> HandEyeCalibration:
        """What the file says; HandEyeError, or ExperimentError for a file that is not there."""
        from aras_visual_servo_base.hand_eye import read_hand_eye

        return read_hand_eye(packages.resolve(self.file), self.units)


@dataclass(frozen=True)
class CalibrationOffset:
    """How the controller's idea of the camera differs from the camera.

    focal: factor on the focal length. centre: of the principal point, px (right, down).
    distortion: coefficients that the controller uses; None: the true ones.
    xyz, rpy: where the camera is believed to sit, off its true place, m and rad: in its own optical
        frame (z forward, x right, y down), on every plant.
    hand_eye: file of a hand-eye calibration that says where the camera is believed to be, instead
        of xyz and rpy.
    depth: factor on the depth that the controller believes.
    """

    focal: float = parameter(1.0, ", the factor on the true focal length", above=0.0, most=10.0)
    centre: tuple[float, float] = parameter((0.0, 0.0), "px")
    distortion: tuple[float, ...] | None = None
    xyz: tuple[float, float, float] = parameter((0.0, 0.0, 0.0), "m")
    rpy: tuple[float, float, float] = parameter(
        (0.0, 0.0, 0.0), "rad", least=-HALF_TURN, most=HALF_TURN
    )
    hand_eye: HandEyeSpec | None = None
    depth: float = parameter(1.0, ", the factor on the true depth", above=0.0, most=10.0)

    def __post_init__(self) -> None:
        check(self, ExperimentError, "calibration_offset")
        require(self.hand_eye is None or not self.is_moved,
                "calibration_offset has xyz and rpy, or a hand_eye calibration: one of them")

    @property
    def is_moved(self) -> bool:
        """Whether the camera is believed elsewhere than it is."""
        return any(self.xyz) or any(self.rpy)

    def make_calibrated_camera(self, true_camera: CameraModel) -> CameraModel:
        """Intrinsics that the controller uses; ExperimentError where they are none."""
        K = np.array(true_camera.K).reshape(3, 3)
        K[[0, 1], [0, 1]] *= self.focal
        K[:2, 2] += self.centre
        D = true_camera.D if self.distortion is None else self.distortion
        try:
            return CameraModel(
                true_camera.width,
                true_camera.height,
                tuple(K.ravel().tolist()),
                D,
                true_camera.model,
            )
        except CalibrationError as error:
            raise ExperimentError(f"believed camera: {error}") from None


@dataclass(frozen=True)
class CameraSpec:
    """One of several cameras of an experiment.

    model: name of a preset, path of a YAML file or of a calibration, or the settings: the true one.
    rate: pictures a second; None: the model's.
    xyz, rpy: where it sits in the hand, beside the robot's own camera: in camera_link (x forward, y
        left, z up), m and rad.
    pose: of its optical frame in the world (the arm's base), x, y, z (m), roll, pitch, yaw (rad):
        of one that stands there, and not in the hand.
    frame: its optical frame, where the robot's description has it.
    hand_eye: file of a hand-eye calibration that says where it is, in the hand or in the world; see
        HandEyeSpec.
    delay: s from an exposure to when the loop has the picture.
    calibration_offset: how the controller's idea of it differs; see CalibrationOffset.
    target: what it looks at, where that is not the experiment's target: shape, size, pose, motion.
    target_frame: link that carries what it looks at, where the arm moves that: the target's pose,
        and the camera's, are in this link's frame; '': robot.target_frame.
    """

    model: str | Mapping[str, Any] = parameter(DEFAULT_PRESET, shorthand=True)
    rate: float | None = parameter(None, "1/s", above=0.0)
    xyz: tuple[float, float, float] = parameter((0.0, 0.0, 0.0), "m")
    rpy: tuple[float, float, float] = parameter(
        (0.0, 0.0, 0.0), "rad", least=-HALF_TURN, most=HALF_TURN
    )
    pose: PoseValues | None = parameter(None, "m, rad")
    frame: str = ""
    hand_eye: HandEyeSpec | None = None
    delay: float = parameter(0.0, "s", least=0.0, most=MAX_DELAY)
    calibration_offset: CalibrationOffset = CalibrationOffset()
    target: TargetSpec | None = None
    target_frame: str = ""

    def __post_init__(self) -> None:
        check(self, ExperimentError, "cameras")
        seats = (self.pose is not None, any(self.xyz) or any(self.rpy), bool(self.frame),
                 self.hand_eye is not None)  # fmt: skip
        require(
            sum(seats) < 2,
            "a camera has a pose in the world, or xyz and rpy in the hand, or a frame of the "
            "robot's description, or a hand_eye calibration: one of them",
        )

    @property
    def is_in_description(self) -> bool:
        """Whether the robot's description has its place: that of its own camera, or a frame."""
        placed = self.pose is not None or self.hand_eye is not None
        return not placed and not (any(self.xyz) or any(self.rpy))

    def compute_pose(self) -> np.ndarray:
        """(4, 4) of its optical frame: in the world, or in that of the robot's own camera."""
        if self.pose is not None:
            return matrix_from_xyz_rpy(self.pose[:3], self.pose[3:])
        link = optical_pose(np.eye(4))
        return inverse(link) @ matrix_from_xyz_rpy(self.xyz, self.rpy) @ link


@dataclass(frozen=True, eq=False)
class CameraSetup:
    """A camera of an experiment, with its files read.

    overrides: keys that the experiment sets, by preset or by itself. settings: all that are known,
    with those of the robot's description. config: made of these. true: its intrinsics.
    believed: those that the controller uses.
    """

    name: str
    spec: CameraSpec
    overrides: Mapping[str, Any]
    settings: Mapping[str, Any]
    config: CameraConfig
    true_camera: CameraModel
    calibrated_camera: CameraModel

    @classmethod
    def read(
        cls, name: str, spec: CameraSpec, packages: PackagePath, robot: str,
        description_settings: Mapping[str, Any] = NO_SETTINGS,
    ) -> CameraSetup:
        """Read; see `read_preset`. described: settings of the description's camera, to lie below.
        """
        overrides = read_preset(spec.model, packages, robot)
        if spec.rate is not None:
            overrides["update_rate"] = spec.rate
        settings = merge(description_settings, overrides)
        config = make_camera_config(settings)
        told = true = read_camera_model(config.make_intrinsics())
        if config.legacy_camera_info:  # CameraInfo says Gazebo's formulas
            true = make_camera_model({**settings, "legacy_camera_info": False})
        return cls(
            name,
            spec,
            overrides,
            settings,
            config,
            true,
            spec.calibration_offset.make_calibrated_camera(told),
        )

    @property
    def rate(self) -> float:
        """Pictures a second."""
        return self.config.update_rate

    @property
    def delay(self) -> float:
        """s from an exposure to when the loop has the image: the camera's latency, and `delay`."""
        return self.spec.delay + self.config.latency


def check_simultaneous_images(cameras: Sequence[CameraSetup], duration: float) -> None:
    """ExperimentError where pictures of one instant are never there together.

    Args:
        eyes: those that the scheme reads, the control camera first.
        duration: of the run, s.
    """
    control, *others = cameras
    for other in others:
        first = 1.0 / other.rate + other.delay
        require(
            first < duration,
            f"camera '{other.name}' delivers its first picture after {first:.3g} s, and the run "
            f"lasts {duration:g} s: give it a higher rate, a shorter delay, or the run more time",
        )
        late, early = other, control
        if late.delay < early.delay:
            late, early = early, late
        behind = late.delay - early.delay
        kept = MAX_WAITING_IMAGES / early.rate
        require(
            behind < kept,
            f"pictures of cameras '{early.name}' and '{late.name}' never meet: those of "
            f"'{late.name}' come {behind:.3g} s after those of the same time, and the last "
            f"{MAX_WAITING_IMAGES} "
            f"of '{early.name}' are kept, which are {kept:.3g} s: give the two delays that differ "
            f"by less, or '{early.name}' a lower rate",
        )


def read_preset(
    camera: str | Mapping[str, Any], packages: PackagePath, robot: str
) -> dict[str, Any]:
    """Settings that an experiment names for a camera, as the simulator takes them.

    Args:
        camera: name of a preset of the package `robot`, path of a YAML file or of a calibration
            (`path#name`: of one of its cameras), or keys of their own, laid over the preset or file
            that the key `read_preset` among them names.

    Raises:
        ExperimentError: no such preset, or a file that cannot be used.
    """
    try:
        if isinstance(camera, Mapping):
            own = dict(camera)
            base = own.pop(PRESET_KEY, None)
            if isinstance(named := own.get(CALIBRATION), str):
                own[CALIBRATION] = _resolve_file(named, packages)
            own = apply_calibration(own)
            if PRESET_KEY not in camera:
                return own
            require(isinstance(base, str), f"camera.{PRESET_KEY} is {base!r}, must be the name of "
                                           "a "
                                           "preset or the path of a file")  # fmt: skip
            return merge(read_preset(base, packages, robot), own)
        if "/" in camera or Path(camera.partition("#")[0]).suffix:
            return read_camera(_resolve_file(camera, packages))
        folder = packages.resolve(f"package://{robot}/package.xml").parent / PRESET_FOLDER
        known = sorted(path.stem for path in folder.glob("*.yaml"))
        require(camera in known, f"camera '{camera}' is no preset: {suggest(camera, known)}")
        return read_camera(folder / f"{camera}.yaml")
    except CameraError as error:
        raise ExperimentError(str(error)) from None


def _resolve_file(name: str, packages: PackagePath) -> str:
    """The absolute path of a camera's file, with the `#name` of the camera in it."""
    path, hash_, camera = name, "", ""
    if "#" in name and not Path(name).expanduser().is_file():
        path, hash_, camera = name.rpartition("#")
    return f"{packages.resolve(path).resolve()}{hash_}{camera}"


def make_camera_config(settings: Mapping[str, Any]) -> CameraConfig:
    """A camera with these settings; ExperimentError where they are impossible."""
    try:
        return CameraConfig.from_mapping({"name": "camera", **settings})
    except CameraError as error:
        raise ExperimentError(str(error)) from None


def make_camera_model(settings: Mapping[str, Any]) -> CameraModel:
    """Intrinsics of a camera with these settings; ExperimentError where they are impossible."""
    return read_camera_model(make_camera_config(settings).make_intrinsics())


def read_camera_model(info: Any) -> CameraModel:
    """Intrinsics of a simulated sensor's `info`."""
    K = tuple(float(k) for k in np.ravel(info.K))
    return CameraModel(info.width, info.height, K, tuple(map(float, info.D)), info.model)


def is_in_view(outline: np.ndarray, camera: CameraModel, margin: float = 2.0) -> bool:
    """Whether an outline (n, 2), normalised, is wholly in the picture, `margin` px inside."""
    u, v = camera.project(*subdivide(outline).T)
    return bool(
        (u >= margin).all()
        and (u <= camera.width - 1 - margin).all()
        and (v >= margin).all()
        and (v <= camera.height - 1 - margin).all()
    )


def draw_outline(outline: np.ndarray | None, camera: CameraModel) -> np.ndarray:
    """Picture (rows, columns) uint8 of a dark outline (n, 2) on white ground; None: the ground.

    A pixel is as dark as the outline covers it; edges are curved as the lens curves them.
    """
    picture = np.full((camera.height, camera.width), WHITE_LEVEL, np.uint8)
    if outline is None:
        return picture
    vertices = subdivide(outline) if camera.is_distorted else outline
    pixels = np.column_stack(camera.project(*vertices.T))
    low = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - 1, 0)
    high = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + 2, (camera.width, camera.height))
    if (high <= low).any():
        return picture
    coverage = _coverage(pixels - low, *(high - low).tolist())
    part = np.round(WHITE_LEVEL + (DARK_LEVEL - WHITE_LEVEL) * coverage).astype(np.uint8)
    picture[low[1] : high[1], low[0] : high[0]] = part
    return picture


def _coverage(polygon: np.ndarray, width: int, height: int) -> np.ndarray:
    """Part (height, width) of each pixel that a polygon (n, 2), px, covers; centres are whole.

    Exact: what of a pixel is left of an edge counts with the sign of the edge's direction. Along a
    piece of an edge within a row, the part to its left runs linearly between 0 and 1.
    """
    ends = np.roll(polygon, -1, axis=0)
    rising = ends[:, 1] != polygon[:, 1]
    begin, end = polygon[rising], ends[rising]
    sign = np.sign(end[:, 1] - begin[:, 1])
    rows = np.arange(height)[:, None] - 0.5
    low = np.clip(np.minimum(begin[:, 1], end[:, 1]), rows, rows + 1.0)
    high = np.clip(np.maximum(begin[:, 1], end[:, 1]), rows, rows + 1.0)
    row, edge = np.nonzero(high > low)
    low, high = low[row, edge], high[row, edge]
    slope = ((end - begin)[:, 0] / (end - begin)[:, 1])[edge]
    left = (np.arange(width) - 0.5)[None]
    first = (begin[edge, 0] + slope * (low - begin[edge, 1]))[:, None] - left
    last = (begin[edge, 0] + slope * (high - begin[edge, 1]))[:, None] - left
    across = last - first
    steep = np.abs(across) < 1e-6
    mean = np.where(
        steep,
        np.clip(0.5 * (first + last), 0.0, 1.0),
        (_ramp(last) - _ramp(first)) / np.where(steep, 1.0, across),
    )
    coverage = np.zeros((height, width))
    np.add.at(coverage, row, (sign[edge] * (high - low))[:, None] * mean)
    return np.clip(np.abs(coverage), 0.0, 1.0)


def _ramp(x: np.ndarray) -> np.ndarray:
    """Integral from -inf to x of clip(x, 0, 1)."""
    within = np.clip(x, 0.0, 1.0)
    return 0.5 * within * within + np.maximum(x - 1.0, 0.0)
