"""Camera settings: from the URDF's sensor, overridden by a preset, checked before anything runs."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from ..errors import CameraError
from .model import CameraIntrinsics, camera_matrix, projection_matrix


@dataclass(frozen=True)
class CameraConfig:
    """One camera.

    width, height: px. horizontal_fov: rad; gives fx = fy where camera_matrix is None.
    update_rate: Hz of simulated time. camera_matrix: (fx, fy, cx, cy), px.
    near, far: clip distances, m. xyz, rpy: the sensor in its link (x forward, z up), m and rad.
    """

    name: str = "camera"
    link: str = ""
    width: int = 320
    height: int = 240
    horizontal_fov: float = 1.047
    update_rate: float = 30.0
    format: str = "R8G8B8"
    near: float = 0.1
    far: float = 100.0
    xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    camera_matrix: tuple[float, float, float, float] | None = None
    distortion_model: str = "plumb_bob"
    distortion_coefficients: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    hack_baseline: float = 0.0
    legacy_camera_info: bool = False
    seed: int = 0
    # Names for the ROS side, not used here.
    camera_name: str = ""
    robot_namespace: str = ""
    image_topic: str = "image_raw"
    info_topic: str = "camera_info"
    frame_name: str = ""

    def __post_init__(self) -> None:
        self._check(self.width >= 1 and self.height >= 1,
                    f"an image of {self.width} x {self.height} pixels is empty")
        self._check(math.isfinite(self.update_rate) and self.update_rate > 0.0,
                    f"update_rate {self.update_rate} Hz: give a rate above 0")
        self._check(0.0 < self.near < self.far,
                    f"clip distances near={self.near} far={self.far}: need 0 < near < far")
        self._check(0.0 < self.horizontal_fov < math.pi,
                    f"horizontal_fov {self.horizontal_fov} rad: a pinhole reaches above 0 and "
                    "below pi; take a fisheye lens for more")

    def _check(self, condition: bool, message: str) -> None:
        if not condition:
            raise CameraError(f"camera '{self.name}': {message}")

    @property
    def K(self) -> np.ndarray:
        """(3, 3) camera matrix of the rendered picture."""
        if self.camera_matrix is not None:
            return camera_matrix(*self.camera_matrix)
        f = self.width / (2.0 * math.tan(self.horizontal_fov / 2.0))
        return camera_matrix(f, f, (self.width - 1) / 2, (self.height - 1) / 2)

    def intrinsics(self) -> CameraIntrinsics:
        """What CameraInfo publishes: the rendered camera, or upstream's formulas on request."""
        K = self.K
        if self.legacy_camera_info:
            K = camera_matrix(K[0, 0], K[0, 0], (self.width + 1) / 2, (self.height + 1) / 2)
        return CameraIntrinsics(
            self.width, self.height, K, tuple(self.distortion_coefficients),
            self.distortion_model, np.eye(3), projection_matrix(K, self.hack_baseline),
        )

    @classmethod
    def from_description(cls, camera: Any, overrides: Mapping[str, Any] | None = None
                         ) -> CameraConfig:
        """Settings of a description.CameraDescription with the keys of a preset laid over it.

        Raises CameraError for an unknown key, naming the nearest one there is.
        """
        plugin = getattr(camera, "plugin", None)
        xyz, rpy = camera.pose if camera.pose is not None else ((0, 0, 0), (0, 0, 0))
        values: dict[str, Any] = {
            "name": camera.name, "link": camera.link, "width": camera.width,
            "height": camera.height, "horizontal_fov": camera.horizontal_fov,
            "update_rate": camera.update_rate or 30.0, "format": camera.format,
            "near": camera.near, "far": camera.far, "xyz": tuple(xyz), "rpy": tuple(rpy),
        }
        if plugin is not None:
            values |= {
                "camera_name": plugin.camera_name, "robot_namespace": plugin.robot_namespace,
                "image_topic": plugin.image_topic, "info_topic": plugin.info_topic,
                "frame_name": plugin.frame_name, "hack_baseline": plugin.hack_baseline,
            }
            if plugin.update_rate:
                values["update_rate"] = min(values["update_rate"], plugin.update_rate)
        config = cls(**{k: v for k, v in values.items() if v is not None})
        return config.overridden(overrides or {})

    def overridden(self, overrides: Mapping[str, Any]) -> CameraConfig:
        """A copy with the keys of a preset file laid over it."""
        known = {f.name for f in fields(self)}
        values = {}
        for key, value in overrides.items():
            if key not in known:
                near = difflib.get_close_matches(key, known, n=1, cutoff=0.0)[0]
                raise CameraError(
                    f"camera '{self.name}': unknown setting '{key}'; the nearest is '{near}'"
                )
            if key == "camera_matrix" and isinstance(value, Mapping):
                value = tuple(float(value[k]) for k in ("fx", "fy", "cx", "cy"))
            elif isinstance(value, list):
                value = tuple(float(v) for v in value)
            values[key] = value
        return replace(self, **values)
