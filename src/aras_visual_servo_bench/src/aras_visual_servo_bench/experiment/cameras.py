"""Cameras of an experiment, read from presets, files and settings, and drawings of outlines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from aras_sim_bridge.camera import CameraConfig
from aras_sim_bridge.camera.calibration_loader import CALIBRATION_KEY as CALIBRATION
from aras_sim_bridge.camera.calibration_loader import apply_calibration
from aras_sim_bridge.camera.camera_file import read_camera
from aras_sim_bridge.errors import CameraError
from aras_visual_servo_base.names import suggest
from aras_visual_servo_base.setting_values import merge
from aras_visual_servo_camera.camera_model import CameraModel, subdivide
from aras_visual_servo_controller.observation.camera_rig import MAX_WAITING_IMAGES

from ..errors import ExperimentError, catch_setting_errors, require
from .camera_specs import CameraSpec
from .packages import PackagePath

PRESET_FOLDER = "config/cameras"
PRESET_KEY = "preset"  # key of a camera's settings that names a preset
# grey levels of the table and of the target in drawn images, equal to those in rendered images
WHITE_LEVEL, DARK_LEVEL = 255, 0


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
        description_settings: Mapping[str, Any],
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
        calibrated = spec.calibration_offset.make_calibrated_camera(published)
        return cls(name, spec, overrides, settings, config, true, calibrated)

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
    with catch_setting_errors(CameraError):
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
    with catch_setting_errors(CameraError):
        return CameraConfig.from_mapping({"name": "camera", **settings})


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


def is_in_view(
    outline: np.ndarray, camera: CameraModel, margin: float = 2.0, pixels: np.ndarray | None = None
) -> bool:
    """Return True if an outline is completely inside the image.

    Args:
        outline: corners (n, 2) in normalised coordinates.
        margin: minimum distance of the outline from the image border, px.
        pixels: corners (n, 2) in the image, px; None: they are computed.
    """
    if pixels is None or camera.is_distorted:
        pixels = _project_outline(outline, camera)
    columns, rows = pixels.T.tolist()
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
