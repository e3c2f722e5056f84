"""Settings of a camera, and their checks.

The settings come from the camera's <sensor> in the URDF and from a preset file.
"""

from __future__ import annotations

import json
import math
import re
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np

from aras_visual_servo_base.lenses import kannala_brandt_fold
from aras_visual_servo_base.names import resolve_name
from aras_visual_servo_base.setting_values import merge
from aras_visual_servo_base.settings import build, convert_fields, parameter
from aras_visual_servo_base.settings import check as check_bounds

from ..description import CameraDescription, DepthDescription
from ..errors import CameraError
from .calibration_loader import apply_calibration
from .effects import Effects
from .intrinsics import CameraIntrinsics, RenderProjection, camera_matrix, projection_matrix
from .lens import (
    COEFFICIENTS,
    LARGEST_ANGLE,
    RADIUS_FUNCTION,
    BrownLens,
    FisheyeLens,
    check_fisheye,
)
from .lens import fit_fisheye as ideal_coefficients
from .pixel_formats import find_encoding
from .shutter import compute_duration
from .vibration import Shake

LARGEST_SIDE = 16384  # largest width and largest height of an image, px
LARGEST_AREA = 1 << 25  # largest number of pixels of an image; rendering such an image needs 0.5 GB
# Matches one part of a ROS name: letters, digits and underscores, without a slash.
_NAME = re.compile(r"[A-Za-z]\w*", re.ASCII)


FloatTriple = tuple[float, float, float]


@dataclass(frozen=True)
class CameraMatrixEntry:
    """Camera matrix in a settings file: focal lengths and principal point, px."""

    fx: float
    fy: float
    cx: float
    cy: float


@dataclass(frozen=True)
class CameraConfig:
    """Settings of one camera; every field can be a key of a preset file.

    Attributes:
        name: name of the camera, for messages.
        link: link on which the camera is mounted.
        width, height: image size, px.
        horizontal_fov: horizontal field of view, rad. It determines fx = fy if camera_matrix is
            None.
        update_rate: frame rate, Hz of simulated time.
        format: pixel format, named as in Gazebo (R8G8B8) or ROS (rgb8).
        near, far: clip distances, m.
        xyz, rpy: pose of the sensor (x forward, z up) in its link, m and rad.
        lens: pinhole, equidistant, stereographic, equisolid or orthographic.
        camera_matrix: (fx, fy, cx, cy), px. If None, it is computed from horizontal_fov, with the
            principal point at the centre of the image.
        distortion_model: distortion model of CameraInfo: plumb_bob, rational_polynomial or
            equidistant.
        distortion_coefficients: coefficients as in CameraInfo; empty for no distortion.
        cutoff_angle: angle from the axis beyond which the image is black, rad; None for the limit
            of the lens.
        rectification_matrix: R (3, 3) in CameraInfo, row by row; None for the identity. It does not
            affect the image.
        projection_matrix: P (3, 4) in CameraInfo, row by row; None for one that is computed from K
            and hack_baseline. It does not affect the image.
        hack_baseline: baseline of a stereo camera in CameraInfo's P, m (Gazebo's hackBaseline).
        legacy_camera_info: whether CameraInfo is computed from `declared` with Gazebo's formulas
            instead of describing the rendered image.
        declared: eight settings of Gazebo's camera plug-in: focalLength, Cx, Cy, distortionK1,
            distortionK2, distortionT1, distortionT2 and distortionK3. Each of the first three is
            computed if it is 0.
        depth, segmentation: whether to deliver depth images and segmentations, too.
        depth_topics: topics and format of the depth images.
        effects: image effects, see effects.Effects.
        shake: vibration of the camera, see vibration.Shake; None for a rigid mounting.
        latency: time from the stamp of an image to its publication, s.
        seed: seed of all random effects.
        trigger_topic: topic whose messages make the camera expose once each; '' for a camera that
            exposes at update_rate.
        shutter: name of a group of cameras. The cameras of one model with the same name expose
            together; '' for an independent camera.
    """

    name: str = "camera"
    link: str = ""
    width: int = parameter(320, "px", least=1, most=LARGEST_SIDE)
    height: int = parameter(240, "px", least=1, most=LARGEST_SIDE)
    horizontal_fov: float = 1.047
    update_rate: float = parameter(30.0, "Hz", above=0.0)
    format: str = "R8G8B8"
    near: float = parameter(0.1, "m", above=0.0)
    far: float = parameter(100.0, "m", above=0.0)
    xyz: FloatTriple = (0.0, 0.0, 0.0)
    rpy: FloatTriple = (0.0, 0.0, 0.0)
    lens: str = parameter("pinhole", choices=RADIUS_FUNCTION)
    camera_matrix: tuple[float, float, float, float] | None = None
    distortion_model: str = parameter("", choices=("", *COEFFICIENTS))
    distortion_coefficients: tuple[float, ...] = ()
    cutoff_angle: float | None = None
    rectification_matrix: tuple[(float,) * 9] | None = None
    projection_matrix: tuple[(float,) * 12] | None = None
    hack_baseline: float = 0.0
    legacy_camera_info: bool = False
    declared: tuple[float, float, float, float, float, float, float, float] = (0.0,) * 8
    depth: bool = False
    segmentation: bool = False
    depth_topics: DepthDescription = field(default_factory=DepthDescription)
    effects: Effects = field(default_factory=Effects)
    shake: Shake | None = None
    latency: float = parameter(0.0, "s", least=0.0)
    seed: int = parameter(0, least=0)
    # Only the ROS layer uses the following names of the camera, its topics and its frames.
    camera_name: str = ""
    robot_namespace: str = ""
    image_topic: str = "image_raw"
    info_topic: str = "camera_info"
    trigger_topic: str = ""
    shutter: str = ""
    frame_name: str = ""
    optical_frame_name: str = ""

    def __post_init__(self) -> None:
        self._fill_in_lens()
        check_bounds(self, CameraError, f"camera '{self.name}': ")
        check = self._check
        check(self.width * self.height <= LARGEST_AREA,
              f"an image of {self.width} x {self.height} px has more than {LARGEST_AREA} pixels; "
              "reduce width and height")
        self._check_names()
        check(self.near < self.far,
              f"clip distances are near={self.near} far={self.far}, must fulfil 0 < near < far")
        self.check_rate(self.update_rate)
        find_encoding(self.format, self.name)
        self._check_lens()
        if self.camera_matrix is not None:
            fx, fy, cx, cy = self.camera_matrix
            check(fx > 0 and fy > 0,
                  f"camera_matrix has fx={fx} fy={fy}: give focal lengths above 0")
        if isinstance(self.projection.lens, FisheyeLens):
            check_fisheye(self.projection.lens, self.name)
        self._check_lens_fold()

    def _fill_in_lens(self) -> None:
        """Set the lens to equidistant if the distortion model is; set a missing distortion model.

        The missing model is plumb_bob for a pinhole lens and equidistant for other lenses.
        """
        lens, model = self.lens, self.distortion_model
        if model == "equidistant" and lens == "pinhole":
            lens = "equidistant"
        if not model:
            model = "plumb_bob" if lens == "pinhole" else "equidistant"
        object.__setattr__(self, "lens", lens)
        object.__setattr__(self, "distortion_model", model)
        object.__setattr__(self, "distortion_coefficients",
                           tuple(float(k) for k in self.distortion_coefficients))

    def _check_lens(self) -> None:
        check = self._check
        check((self.lens == "pinhole") != (self.distortion_model == "equidistant"),
              f"distortion_model '{self.distortion_model}' does not fit lens '{self.lens}'; "
              "use equidistant for wide-angle lenses, otherwise plumb_bob or rational_polynomial")
        D = self.distortion_coefficients
        counts = COEFFICIENTS[self.distortion_model]
        check(len(D) in (0, *counts),
              f"distortion_coefficients are {list(D)}, but the distortion_model "
              f"{self.distortion_model} needs {' or '.join(map(str, counts))} finite numbers")
        check(not any(D) or self.lens in ("pinhole", "equidistant"),
              f"lens '{self.lens}' has no distortion_coefficients; remove them, or use the lens "
              "equidistant")
        reach = LARGEST_ANGLE[self.lens]
        fov = self.horizontal_fov
        if self.camera_matrix is None or self.lens == "pinhole":
            limit = 2 * reach + (0.0 if self.lens == "pinhole" else 1e-9)
            check(0.0 < fov < limit,
                  f"horizontal_fov is {fov} rad; with the lens {self.lens} it must be above 0 and "
                  f"below {limit:.4g} rad" + ("; use a fisheye lens for more"
                                        if self.lens == "pinhole" and fov >= limit else ""))
        if self.cutoff_angle is not None:
            check(self.lens != "pinhole",
                  "cutoff_angle has no effect on the lens pinhole; remove it, or use a fisheye "
                  "lens")
            check(0.0 < self.cutoff_angle <= reach + 1e-9,
                  f"cutoff_angle is {self.cutoff_angle} rad; with the lens {self.lens} it must be "
                  f"above 0 and at most {reach:.4g} rad")

    def _check_names(self) -> None:
        keys = ("camera_name", "robot_namespace", "image_topic", "info_topic", "trigger_topic")
        names = {key: getattr(self, key) for key in keys}
        names |= {f"depth_topics/{key}": getattr(self.depth_topics, key)
                  for key in ("image", "info", "points")}
        for key, name in names.items():
            parts = [part for part in name.split("/") if part]
            self._check(all(map(_NAME.fullmatch, parts)),
                        f"{key} '{name}' is not a valid ROS name; start each part with a "
                        "letter, and use only letters, digits and underscores")
        topics = {self.topic_root, *map(self.resolve_topic, (self.image_topic, self.info_topic))}
        self._check(len(topics) == 3,
                    f"image_topic '{self.image_topic}' and info_topic '{self.info_topic}' must be "
                    "different names")

    def _check_lens_fold(self) -> None:
        """Check that the distortion maps at most one ray to each pixel of the image.

        Two rays share a pixel if, inside the image, the distorted radius stops increasing with the
        undistorted radius. If a cutoff_angle is set, nothing is checked.
        """
        if not any(self.distortion_coefficients) or self.cutoff_angle is not None:
            return
        lens = self.projection.lens
        if isinstance(lens, FisheyeLens) and lens.cutoff >= LARGEST_ANGLE[self.lens]:
            return
        w, h = self.width - 1, self.height - 1
        border = np.array([[x, y] for t in np.linspace(0, 1, 33) for x, y in
                           ((t * w, 0), (t * w, h), (0, t * h), (w, t * h))])
        angle = (f"at {math.degrees(lens.cutoff):.1f} deg from the optical axis, "
                 if isinstance(lens, FisheyeLens) else "")
        self._check(bool(np.isfinite(self.projection.unproject(border)).all()),
                    f"with distortion_coefficients {list(self.distortion_coefficients)}, the "
                    f"distorted radius stops increasing {angle}inside the image, so that two "
                    "directions share one pixel; make the coefficients smaller or the focal length "
                    "longer")

    def check_rate(self, rate: float) -> None:
        """Check that the image period at `rate` (Hz) is long enough for exposure and read-out.

        Raises:
            CameraError: the period is too short.
        """
        e, rows = self.effects, f"row_time {self.effects.row_time:g} s of {self.height} rows"
        durations = {f"exposure_time {e.exposure_time:g} s": e.exposure_time,
                 f"{rows}, which takes {e.row_time * self.height:g} s in "
                 "all,": e.row_time * self.height,
                 f"exposure_time and {rows}, together {compute_duration(e, self.height):g} s,":
                     compute_duration(e, self.height)}  # fmt: skip
        for what, time in durations.items():
            self._check(time < 1.0 / rate, f"{what} must be shorter than the image period of "
                        f"{1.0 / rate:g} s; lower the rate or shorten this time")

    def _check(self, condition: bool, message: str) -> None:
        if not condition:
            raise CameraError(f"camera '{self.name}': {message}")

    @cached_property
    def encoding(self) -> str:
        """ROS image encoding of the pixel format."""
        return find_encoding(self.format, self.name)

    @property
    def K(self) -> np.ndarray:
        """Camera matrix (3, 3) of the rendered image, px."""
        if self.camera_matrix is not None:
            return camera_matrix(*self.camera_matrix)
        f = self.width / (2.0 * float(RADIUS_FUNCTION[self.lens](self.horizontal_fov / 2.0)))
        return camera_matrix(f, f, (self.width - 1) / 2, (self.height - 1) / 2)

    @property
    def projection(self) -> RenderProjection:
        """Projection of the rendered image."""
        D = self.distortion_coefficients
        if self.lens == "pinhole":
            return RenderProjection(self.K, BrownLens((*D, *(0.0,) * (5 - len(D)))))
        reach = LARGEST_ANGLE[self.lens] if self.cutoff_angle is None else self.cutoff_angle
        if not D:
            D = ideal_coefficients(self.lens, LARGEST_ANGLE[self.lens])
        elif self.cutoff_angle is None:
            reach = min(reach, kannala_brandt_fold(D) * (1.0 - 1e-6))
        return RenderProjection(self.K, FisheyeLens(D, reach))

    def make_intrinsics(self) -> CameraIntrinsics:
        """Return the content of CameraInfo.

        It describes the rendered image; if legacy_camera_info is set, it contains the results of
        Gazebo's formulas for `declared` instead.
        """
        K, D, name = self.K, tuple(self.projection.lens.D), self.distortion_model
        if self.legacy_camera_info:
            f, cx, cy, *D = self.declared
            f = f or self.width / (2.0 * math.tan(min(self.horizontal_fov, 3.14) / 2.0))
            K = camera_matrix(f, f, cx or (self.width + 1) / 2, cy or (self.height + 1) / 2)
            D, name = tuple(D), "plumb_bob"
        R, P = np.eye(3), projection_matrix(K, self.hack_baseline)
        if self.rectification_matrix is not None and not self.legacy_camera_info:
            R = np.reshape(self.rectification_matrix, (3, 3))
        if self.projection_matrix is not None and not self.legacy_camera_info:
            P = np.reshape(self.projection_matrix, (3, 4))
        return CameraIntrinsics(self.width, self.height, K, D, name, R, P)

    @classmethod
    def from_description(cls, camera: CameraDescription,
                         overrides: Mapping[str, object] | None = None) -> CameraConfig:
        """Return the settings of a camera of a robot description, changed by `overrides`.

        `overrides` are settings of a preset. They are merged key by key, also in nested settings:
        an image effect that is not in `overrides` keeps its value of the description.

        Raises:
            CameraError: the message names the wrong key.
        """
        from .from_description import read_settings

        described, own = read_settings(camera), apply_calibration(overrides or {})
        if own.get("lens", described.get("lens")) != described.get("lens"):
            # The settings select another lens, so the cutoff angle of the description is not valid.
            described.pop("cutoff_angle", None)
        return cls.from_mapping(merge(described, own))

    @classmethod
    def from_mapping(cls, values: Mapping[str, object]) -> CameraConfig:
        """Return the settings from the keys of a preset file.

        `camera_matrix` may be a mapping with the keys fx, fy, cx and cy, or a list of these four
        numbers. `effects` is a mapping with the fields of effects.Effects. `calibration` is the
        path of a calibration file (see calibration_loader.py).

        Raises:
            CameraError: the message names the wrong key.
        """
        where = f"camera '{values.get('name', 'camera')}': "
        values = apply_calibration(values)
        try:
            text = json.dumps(values)
        # JSON cannot represent one of the values. JSON is the key of the cache, so build the
        # configuration without the cache.
        except (TypeError, ValueError):
            return build(cls, cls.check_keys(values, where), where, CameraError)
        return _build_config(cls, text, where)

    @classmethod
    def check_keys(cls, values: Mapping[str, object], where: str) -> dict[str, object]:
        """Return settings of a camera, converted to the types of the fields of CameraConfig.

        `values` need not contain all fields.

        Raises:
            CameraError: the message starts with `where` and names the wrong key.
        """
        matrix = values.get("camera_matrix")
        if isinstance(matrix, Mapping):
            given = build(CameraMatrixEntry, matrix, f"{where}camera_matrix", CameraError)
            values = {**values, "camera_matrix": (given.fx, given.fy, given.cx, given.cy)}
        return convert_fields(cls, values, where, CameraError)

    @property
    def topic_root(self) -> str:
        """Absolute ROS name of the camera, composed of the robot_namespace and the camera_name."""
        return resolve_name(f"{self.robot_namespace}/{self.camera_name}")

    def resolve_topic(self, name: str) -> str:
        """Return the absolute name of a topic of the camera; absolute names are not changed."""
        return resolve_name(self.topic_root, name)

    @property
    def names(self) -> frozenset[str]:
        """Absolute names that no other camera may have: topic_root, image topic and info topic."""
        topics = (self.resolve_topic(name) for name in (self.image_topic, self.info_topic))
        return frozenset((self.topic_root, *topics))


@lru_cache(maxsize=64)
def _build_config(cls: type[CameraConfig], text: str, where: str) -> CameraConfig:
    """Return the configuration of a camera from its settings in JSON.

    The result is cached, because a process often creates the same cameras many times.
    """
    return build(cls, cls.check_keys(json.loads(text), where), where, CameraError)


def derive_seed(seed: int, name: str) -> int:
    """Return a seed for the camera `name`, so that the cameras of a run have independent noise."""
    return (int(seed) & 0xFFFFFFFF) ^ zlib.crc32(name.encode())
