"""Settings of an experiment's cameras: the true camera, and the controller's calibration of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from aras_sim_bridge.camera import CameraConfig
from aras_sim_bridge.camera.calibration_loader import CALIBRATION_KEY as CALIBRATION
from aras_sim_bridge.camera.calibration_loader import apply_calibration
from aras_sim_bridge.camera.camera_file import read_camera
from aras_sim_bridge.errors import CameraError
from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.poses import LENGTH_UNITS, inverse, matrix_from_xyz_rpy, optical_pose
from aras_visual_servo_base.setting_values import merge
from aras_visual_servo_base.settings import check, parameter
from aras_visual_servo_camera.camera_model import CameraModel, subdivide
from aras_visual_servo_camera.errors import InvalidIntrinsicsError
from aras_visual_servo_controller.observation.camera_rig import MAX_WAITING_IMAGES

from ..errors import ExperimentError, require
from ..targets.target_spec import PoseValues, TargetSpec
from .packages import PackagePath

if TYPE_CHECKING:
    from aras_visual_servo_base.hand_eye_files import HandEyeCalibration

# Limit of angles in settings: half a turn, rad, rounded up, because a file may contain 3.142
# instead of pi.
HALF_TURN = 3.142
MAX_DELAY = 10.0  # s
PRESET_FOLDER = "config/cameras"
PRESET_KEY = "preset"  # key of a camera's settings that names a preset
DEFAULT_PRESET = "original"
NO_SETTINGS: Mapping[str, Any] = MappingProxyType({})
WORLD = "world"  # value of HandEyeSpec.link for a camera that is fixed in the world
# grey levels of the table and of the target in drawn images, equal to those in rendered images
WHITE_LEVEL, DARK_LEVEL = 255, 0


@dataclass(frozen=True)
class HandEyeSpec:
    """File with the result of a hand-eye calibration; see aras_visual_servo_base.hand_eye_files.

    file: path of the file.
    units: unit of the lengths in the file: m, cm or mm; '': the unit that the file states, or m if
        it states none.
    link: link that carries the camera; '': the link that the file names; 'world': the camera is
        fixed, and the file gives its pose in the world (the arm's base).
    """

    file: str = parameter(shorthand=True)
    units: str = parameter("", choices=("", *LENGTH_UNITS))
    link: str = ""

    def __post_init__(self) -> None:
        check(self, ExperimentError, "hand_eye")

    def read(self, packages: PackagePath) -> HandEyeCalibration:
        """Read the calibration from the file.

        Raises:
            HandEyeFileError: the file does not contain a calibration.
            ExperimentError: there is no such file.
        """
        from aras_visual_servo_base.hand_eye_files import read_hand_eye

        return read_hand_eye(packages.resolve(self.file), self.units)


@dataclass(frozen=True)
class CalibrationOffset:
    """Difference between the camera that the controller assumes and the true camera.

    focal: assumed focal length divided by the true one.
    centre: offset of the assumed principal point from the true one, px (right, down).
    distortion: distortion coefficients that the controller uses; None: the true coefficients.
    xyz, rpy: offset of the assumed camera pose from the true one, m and rad, in the true optical
        frame (z forward, x right, y down).
    hand_eye: file of a hand-eye calibration that gives the assumed camera pose, instead of xyz and
        rpy.
    depth: depth of the target that the controller assumes, divided by the true depth.
    """

    focal: float = parameter(1.0, ", the ratio of the calibrated to the true focal "
                                  "length", above=0.0, most=10.0)
    centre: tuple[float, float] = parameter((0.0, 0.0), "px")
    distortion: tuple[float, ...] | None = None
    xyz: tuple[float, float, float] = parameter((0.0, 0.0, 0.0), "m")
    rpy: tuple[float, float, float] = parameter(
        (0.0, 0.0, 0.0), "rad", least=-HALF_TURN, most=HALF_TURN
    )
    hand_eye: HandEyeSpec | None = None
    depth: float = parameter(1.0, ", the ratio of the assumed to the true "
                                  "depth", above=0.0, most=10.0)

    def __post_init__(self) -> None:
        check(self, ExperimentError, "calibration_offset")
        require(self.hand_eye is None or not self.is_moved,
                "calibration_offset.hand_eye already gives the camera's pose: leave out "
                "calibration_offset.xyz and rpy, or hand_eye")

    @property
    def is_moved(self) -> bool:
        """True if the assumed camera pose differs from the true one."""
        return any(self.xyz) or any(self.rpy)

    def make_calibrated_camera(self, true_camera: CameraModel) -> CameraModel:
        """Return the intrinsics that the controller uses.

        Raises:
            ExperimentError: the resulting intrinsics are invalid.
        """
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
        except InvalidIntrinsicsError as error:
            raise ExperimentError(f"calibration_offset: {error}") from None


@dataclass(frozen=True)
class CameraSpec:
    """One of several cameras of an experiment.

    model: the true camera: name of a preset, path of a YAML file or of a calibration, or settings.
    rate: number of images per second; None: the rate that `model` gives.
    xyz, rpy: pose of a camera in the hand relative to the robot's own camera, in camera_link (x
        forward, y left, z up), m and rad.
    pose: pose of the optical frame of a fixed camera in the world (the arm's base): x, y, z (m),
        roll, pitch, yaw (rad).
    frame: optical frame of a camera that the robot description contains.
    hand_eye: file of a hand-eye calibration that gives the pose of the camera, in the hand or in
        the world; see HandEyeSpec.
    delay: time from an exposure until the control loop receives the image, s.
    calibration_offset: errors of the controller's calibration; see CalibrationOffset.
    target: target that this camera observes; by default, the target of the experiment.
    target_frame: link of the arm that carries the target of this camera. The poses of target and
        camera are then in the frame of this link. '': the link in robot.target_frame.
    """

    renamed_keys = {"believed": "calibration_offset"}

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
        placements = (self.pose is not None, any(self.xyz) or any(self.rpy), bool(self.frame),
                      self.hand_eye is not None)  # fmt: skip
        require(
            sum(placements) < 2,
            "the pose of a camera is given more than once: give only one of pose (in the world), "
            "xyz and rpy (in the hand), frame (of the robot's description) and hand_eye",
        )

    @property
    def is_in_description(self) -> bool:
        """True if the robot description gives the pose of the camera."""
        has_pose = self.pose is not None or self.hand_eye is not None
        return not has_pose and not (any(self.xyz) or any(self.rpy))

    def compute_pose(self) -> np.ndarray:
        """Return the pose (4, 4) of the camera's optical frame.

        The reference frame is the world if `pose` is set, else the optical frame of the robot's own
        camera.
        """
        if self.pose is not None:
            return matrix_from_xyz_rpy(self.pose[:3], self.pose[3:])
        link = optical_pose(np.eye(4))
        return inverse(link) @ matrix_from_xyz_rpy(self.xyz, self.rpy) @ link


@dataclass(frozen=True, eq=False)
class CameraSetup:
    """Camera of an experiment, after its files have been read.

    overrides: settings of the camera that the experiment gives, itself or by a preset.
    settings: settings of the camera in the robot description, with `overrides` applied.
    config: configuration of the simulated camera, made from `settings`.
    true_camera: intrinsics of the simulated camera.
    calibrated_camera: intrinsics that the controller uses.
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
        """Read the camera `name` of an experiment.

        Args:
            robot: package that holds the presets; see `read_preset`.
            description_settings: settings of the camera in the robot description; the settings in
                `spec` override them.
        """
        overrides = read_preset(spec.model, packages, robot)
        if spec.rate is not None:
            overrides["update_rate"] = spec.rate
        settings = merge(description_settings, overrides)
        config = make_camera_config(settings)
        published = true = read_camera_model(config.make_intrinsics())
        # with legacy_camera_info, the published intrinsics differ from the true ones: they follow
        # Gazebo's formulas
        if config.legacy_camera_info:
            true = make_camera_model({**settings, "legacy_camera_info": False})
        return cls(
            name,
            spec,
            overrides,
            settings,
            config,
            true,
            spec.calibration_offset.make_calibrated_camera(published),
        )

    @property
    def rate(self) -> float:
        """Number of images per second."""
        return self.config.update_rate

    @property
    def delay(self) -> float:
        """Time from an exposure until the control loop receives the image, s.

        The value is the sum of the camera's latency and of `delay` in the experiment.
        """
        return self.spec.delay + self.config.latency


def check_simultaneous_images(cameras: Sequence[CameraSetup], duration: float) -> None:
    """Check that images of the same instant from all cameras are available at the same time.

    Args:
        cameras: the cameras that the scheme reads, the control camera first.
        duration: duration of the run, s.

    Raises:
        ExperimentError: a camera delivers its first image after the end of the run; or the delays
            of two cameras differ so much that the image of one camera is discarded before the image
            of the other arrives.
    """
    control, *others = cameras
    for other in others:
        first = 1.0 / other.rate + other.delay
        require(
            first < duration,
            f"camera '{other.name}' delivers its first image after {first:.3g} s, but the run "
            f"lasts only {duration:g} s: increase the camera's rate, reduce its delay, or increase "
            "the duration of the run",
        )
        late, early = other, control
        if late.delay < early.delay:
            late, early = early, late
        difference = late.delay - early.delay
        stored = MAX_WAITING_IMAGES / early.rate
        require(
            difference < stored,
            f"images of cameras '{early.name}' and '{late.name}' are never available together, "
            f"because those of '{late.name}' arrive {difference:.3g} s later, and only the last "
            f"{MAX_WAITING_IMAGES} images of '{early.name}' ({stored:.3g} s) are stored: make "
            f"the delays more similar, or reduce the rate of camera '{early.name}'",
        )


def read_preset(
    camera: str | Mapping[str, Any], packages: PackagePath, robot: str
) -> dict[str, Any]:
    """Return the camera settings that an experiment gives, with the key names of the simulator.

    Args:
        camera: one of
            name of a preset of the package `robot`;
            path of a YAML file or of a calibration (`path#name` selects one of its cameras);
            mapping of settings; its key `preset` can name a preset or a file, which gives the
            settings that the mapping lacks.
        packages: search path for packages and files.
        robot: package that contains the presets.

    Raises:
        ExperimentError: there is no such preset, or a file cannot be used.
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
            require(
                isinstance(base, str),
                f"camera.{PRESET_KEY} is {base!r}, must be the name of a preset or the path of a "
                "file",
            )
            return merge(read_preset(base, packages, robot), own)
        if "/" in camera or Path(camera.partition("#")[0]).suffix:
            return read_camera(_resolve_file(camera, packages))
        folder = packages.resolve(f"package://{robot}/package.xml").parent / PRESET_FOLDER
        known = sorted(path.stem for path in folder.glob("*.yaml"))
        if camera not in known:
            raise ExperimentError(f"camera '{camera}' is no preset: {suggest(camera, known)}")
        return read_camera(folder / f"{camera}.yaml")
    except CameraError as error:
        raise ExperimentError(str(error)) from None


def _resolve_file(name: str, packages: PackagePath) -> str:
    """Return a path of a camera file as an absolute path; a suffix `#name` is retained."""
    path, hash_, camera = name, "", ""
    if "#" in name and not Path(name).expanduser().is_file():
        path, hash_, camera = name.rpartition("#")
    return f"{packages.resolve(path).resolve()}{hash_}{camera}"


def make_camera_config(settings: Mapping[str, Any]) -> CameraConfig:
    """Make the configuration of a camera from settings with the key names of the simulator.

    Raises:
        ExperimentError: the settings are invalid.
    """
    try:
        return CameraConfig.from_mapping({"name": "camera", **settings})
    except CameraError as error:
        raise ExperimentError(str(error)) from None


def make_camera_model(settings: Mapping[str, Any]) -> CameraModel:
    """Return the intrinsics of a camera with these settings.

    Raises:
        ExperimentError: the settings are invalid.
    """
    return read_camera_model(make_camera_config(settings).make_intrinsics())


def read_camera_model(info: Any) -> CameraModel:
    """Convert the intrinsics of a simulated camera into a camera model."""
    K = tuple(float(k) for k in np.ravel(info.K))
    return CameraModel(info.width, info.height, K, tuple(map(float, info.D)), info.model)


def is_in_view(outline: np.ndarray, camera: CameraModel, margin: float = 2.0) -> bool:
    """Return True if an outline is completely inside the image.

    Args:
        outline: corners (n, 2) in normalised coordinates.
        margin: minimum distance of the outline from the image border, px.
    """
    columns, rows = _project_outline(outline, camera).T.tolist()
    return (
        min(columns) >= margin and max(columns) <= camera.width - 1 - margin
        and min(rows) >= margin and max(rows) <= camera.height - 1 - margin
    )  # fmt: skip


def draw_outline(outline: np.ndarray | None, camera: CameraModel) -> np.ndarray:
    """Draw a dark polygon on a white background.

    The grey level of a pixel is proportional to the fraction of its area that the polygon covers.
    If the camera has lens distortion, the edges are curved.

    Args:
        outline: corners (n, 2) of the polygon in normalised coordinates; None: no polygon.

    Returns:
        Image (rows, columns), uint8.
    """
    from .polygon_drawing import draw_polygon

    image = np.full((camera.height, camera.width), WHITE_LEVEL, np.uint8)
    if outline is not None:
        pixels = _project_outline(outline, camera)
        draw_polygon(pixels, float(WHITE_LEVEL), float(DARK_LEVEL), image)
    return image


def _project_outline(outline: np.ndarray, camera: CameraModel) -> np.ndarray:
    """Return the vertices (m, 2) of an outline (n, 2) in the image, px.

    If the lens has distortion, straight edges become curves, so points are added on each edge.
    """
    return camera.project_points(subdivide(outline) if camera.is_distorted else outline)
