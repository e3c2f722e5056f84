"""Camera settings: from the URDF's sensor, overridden by a preset, checked before anything runs."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields

import numpy as np

from ..description import CameraDescription
from ..errors import CameraError
from .effects import Effects, hint, is_number
from .formats import encoding_of
from .intrinsics import CameraIntrinsics, CameraModel, camera_matrix, projection_matrix
from .lens import COEFFICIENTS, RADIUS, REACH, BrownLens, FisheyeLens, check_fisheye
from .lens import fisheye_coefficients as ideal_coefficients

LARGEST_SIDE = 16384  # px
LARGEST_AREA = 1 << 25  # px; drawing a frame of this size takes 0.5 GB
_NAME = re.compile(r"[A-Za-z]\w*", re.ASCII)  # a part of a name in the ROS graph


@dataclass(frozen=True)
class CameraConfig:
    """One camera; every field can be a key of a preset file.

    width, height: px. horizontal_fov: rad; gives fx = fy where camera_matrix is None.
    update_rate: Hz of simulated time. format: a Gazebo (R8G8B8) or ROS (rgb8) pixel format.
    near, far: clip distances, m. xyz, rpy: the sensor in its link (x forward, z up), m and rad.
    lens: pinhole, equidistant, stereographic, equisolid or orthographic.
    camera_matrix: (fx, fy, cx, cy), px; None: from horizontal_fov, centred.
    distortion_model, distortion_coefficients: as in CameraInfo (plumb_bob,
        rational_polynomial, equidistant); empty coefficients mean none.
    cutoff_angle: the picture is black beyond it, rad from the axis; None: the lens's reach.
    hack_baseline: m, only for CameraInfo's P. legacy_camera_info: publish Gazebo's formulas,
        and with them `declared`, the plugin's focalLength, Cx, Cy, distortionK1, K2, T1, T2, K3,
        of which the first three are computed where they are 0.
    effects: see effects.Effects. latency: s between stamp and publication.
    depth, segmentation: deliver these pictures beside the colour one.
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
    lens: str = "pinhole"
    camera_matrix: tuple[float, float, float, float] | None = None
    distortion_model: str = ""
    distortion_coefficients: tuple[float, ...] = ()
    cutoff_angle: float | None = None
    hack_baseline: float = 0.0
    legacy_camera_info: bool = False
    declared: tuple[float, ...] = (0.0,) * 8
    depth: bool = False
    segmentation: bool = False
    effects: Effects = field(default_factory=Effects)
    latency: float = 0.0
    seed: int = 0
    # Names for the ROS side, not used here.
    camera_name: str = ""
    robot_namespace: str = ""
    image_topic: str = "image_raw"
    info_topic: str = "camera_info"
    frame_name: str = ""
    optical_frame_name: str = ""

    def __post_init__(self) -> None:
        self._fill_in_lens()
        check = self._check
        check(isinstance(self.width, int) and isinstance(self.height, int)
              and self.width >= 1 and self.height >= 1,
              f"an image of {self.width} x {self.height} pixels: give whole numbers above 0")
        check(max(self.width, self.height) <= LARGEST_SIDE
              and self.width * self.height <= LARGEST_AREA,
              f"an image of {self.width} x {self.height} pixels: {LARGEST_SIDE} a side and "
              f"{LARGEST_AREA} in all are possible; make width and height smaller")
        check(self.seed >= 0, f"seed {self.seed}: give a whole number of 0 or more")
        check(math.isfinite(self.hack_baseline),
              f"hack_baseline {self.hack_baseline} m: give a finite number")
        self._check_names()
        check(math.isfinite(self.update_rate) and self.update_rate > 0.0,
              f"update_rate {self.update_rate} Hz: give a rate above 0")
        check(0.0 < self.near < self.far < math.inf,
              f"clip distances near={self.near} far={self.far}: need 0 < near < far")
        check(0.0 <= self.latency < math.inf, f"latency {self.latency} s: give 0 or more")
        check(0.0 <= self.effects.exposure_time < 1.0 / self.update_rate,
              f"exposure_time {self.effects.exposure_time} s: has to be shorter than the period of "
              f"{1.0 / self.update_rate:g} s")
        encoding_of(self.format, self.name)
        self._check_lens()
        if self.camera_matrix is not None:
            fx, fy, cx, cy = self.camera_matrix
            check(fx > 0 and fy > 0 and all(map(math.isfinite, self.camera_matrix)),
                  f"camera_matrix fx={fx} fy={fy} cx={cx} cy={cy}: give finite numbers, focal "
                  "lengths above 0")
        if isinstance(self.model.lens, FisheyeLens):
            check_fisheye(self.model.lens, self.name)
        else:
            self._check_folding()

    def _fill_in_lens(self) -> None:
        """A fisheye distortion model implies the lens, and the lens the model."""
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
        check(self.lens in RADIUS, f"there is no lens '{self.lens}'; there are {', '.join(RADIUS)}")
        check(self.distortion_model in COEFFICIENTS,
              f"there is no distortion_model '{self.distortion_model}'; there are "
              + ", ".join(COEFFICIENTS))
        check((self.lens == "pinhole") != (self.distortion_model == "equidistant"),
              f"distortion_model '{self.distortion_model}' does not go with lens '{self.lens}'; "
              "take equidistant for wide-angle lenses, plumb_bob or rational_polynomial else")
        D = self.distortion_coefficients
        counts = COEFFICIENTS[self.distortion_model]
        check(len(D) in (0, *counts) and all(map(math.isfinite, D)),
              f"distortion_coefficients {list(D)}: {self.distortion_model} takes "
              f"{' or '.join(map(str, counts))} finite numbers")
        check(not any(D) or self.lens in ("pinhole", "equidistant"),
              f"lens '{self.lens}' is an ideal projection; for one with distortion_coefficients "
              "take lens equidistant")
        reach = REACH[self.lens]
        fov = self.horizontal_fov
        if self.camera_matrix is None or self.lens == "pinhole":
            limit = 2 * reach + (0.0 if self.lens == "pinhole" else 1e-9)
            check(0.0 < fov < limit,
                  f"horizontal_fov {fov} rad: lens {self.lens} reaches above 0 and below "
                  f"{limit:.4g} rad" + ("; take a fisheye lens for more"
                                        if self.lens == "pinhole" and fov >= limit else ""))
        if self.cutoff_angle is not None:
            check(self.lens != "pinhole", "cutoff_angle is for wide-angle lenses; leave it out")
            check(0.0 < self.cutoff_angle <= reach + 1e-9,
                  f"cutoff_angle {self.cutoff_angle} rad: lens {self.lens} reaches above 0 and up "
                  f"to {reach:.4g} rad")

    def _check_names(self) -> None:
        for key in ("camera_name", "robot_namespace", "image_topic", "info_topic"):
            parts = [part for part in getattr(self, key).split("/") if part]
            self._check(all(map(_NAME.fullmatch, parts)),
                        f"{key} '{getattr(self, key)}' is no name in a ROS graph; begin with a "
                        "letter and go on with letters, digits and underscores")
        self._check(self.image_topic.strip("/") not in ("", self.info_topic.strip("/"))
                    and bool(self.info_topic.strip("/")),
                    f"image_topic '{self.image_topic}' and info_topic '{self.info_topic}': give "
                    "two different names")

    def _check_folding(self) -> None:
        """Every pixel needs a ray; beyond a fold there is none."""
        if not any(self.distortion_coefficients):
            return
        w, h = self.width - 1, self.height - 1
        border = np.array([[x, y] for t in np.linspace(0, 1, 33) for x, y in
                           ((t * w, 0), (t * w, h), (0, t * h), (w, t * h))])
        self._check(bool(np.isfinite(self.model.unproject(border)).all()),
                    f"distortion_coefficients {list(self.distortion_coefficients)} fold the "
                    "picture over inside the image; make them smaller or the focal length longer")

    def _check(self, condition: bool, message: str) -> None:
        if not condition:
            raise CameraError(f"camera '{self.name}': {message}")

    @property
    def encoding(self) -> str:
        """ROS image encoding of the format."""
        return encoding_of(self.format, self.name)

    @property
    def K(self) -> np.ndarray:
        """(3, 3) camera matrix of the rendered picture."""
        if self.camera_matrix is not None:
            return camera_matrix(*self.camera_matrix)
        f = self.width / (2.0 * float(RADIUS[self.lens](self.horizontal_fov / 2.0)))
        return camera_matrix(f, f, (self.width - 1) / 2, (self.height - 1) / 2)

    @property
    def model(self) -> CameraModel:
        """The projection that the pixels follow."""
        D = self.distortion_coefficients
        if self.lens == "pinhole":
            return CameraModel(self.K, BrownLens((*D, *(0.0,) * (5 - len(D)))))
        reach = REACH[self.lens] if self.cutoff_angle is None else self.cutoff_angle
        if not D:
            D = ideal_coefficients(self.lens, REACH[self.lens])
        return CameraModel(self.K, FisheyeLens(D, reach))

    def intrinsics(self) -> CameraIntrinsics:
        """What CameraInfo publishes: the rendered camera, or upstream's formulas on request."""
        K, D, name = self.K, tuple(self.model.lens.D), self.distortion_model
        if self.legacy_camera_info:
            f, cx, cy, *D = self.declared
            f = f or self.width / (2.0 * math.tan(min(self.horizontal_fov, 3.14) / 2.0))
            K = camera_matrix(f, f, cx or (self.width + 1) / 2, cy or (self.height + 1) / 2)
            D, name = tuple(D), "plumb_bob"
        return CameraIntrinsics(self.width, self.height, K, D, name, np.eye(3),
                                projection_matrix(K, self.hack_baseline))

    @classmethod
    def from_description(cls, camera: CameraDescription,
                         overrides: Mapping[str, object] | None = None) -> CameraConfig:
        """Settings of a description's camera with the keys of a preset laid over it.

        Raises CameraError for an unknown key, naming the nearest one there is.
        """
        from .from_description import settings

        values = settings(camera)
        return cls.from_mapping({**values, **_checked(overrides or {}, values["name"])})

    @classmethod
    def from_mapping(cls, values: Mapping[str, object]) -> CameraConfig:
        """Settings from a preset file's keys.

        camera_matrix is a mapping fx, fy, cx, cy or four numbers; effects a mapping of
        effects.Effects' fields.
        """
        name = str(values.get("name", "camera"))
        values = _checked(values, name)
        return cls(**_all_converted(values, name))

    @property
    def topic_root(self) -> str:
        """Absolute name below which ROS finds this camera: /robotNamespace/cameraName."""
        return _absolute(self.robot_namespace, self.camera_name)

    @property
    def names(self) -> frozenset[str]:
        """Absolute names that no other camera may have: its root, its image and its info topic."""
        root = self.topic_root
        topics = (_absolute(root, topic) for topic in (self.image_topic, self.info_topic))
        return frozenset((root, *topics))


def _absolute(*names: str) -> str:
    return "/" + "/".join(part for name in names for part in name.split("/") if part)


def _checked(values: Mapping[str, object], name: str) -> dict[str, object]:
    known = {f.name for f in fields(CameraConfig)}
    for key in values:
        if key not in known:
            near = difflib.get_close_matches(str(key), known, n=1, cutoff=0.0)[0]
            raise CameraError(f"camera '{name}': unknown setting '{key}'; the nearest is '{near}'")
    return dict(values)


_NUMBERS = {"horizontal_fov", "update_rate", "near", "far", "cutoff_angle", "hack_baseline",
            "latency"}
_WHOLE = {"width", "height", "seed"}
_TRUTHS = {"legacy_camera_info", "depth", "segmentation"}
_LISTS = {"xyz": 3, "rpy": 3, "camera_matrix": 4, "distortion_coefficients": None,
          "declared": 8}


def _all_converted(values: Mapping[str, object], name: str) -> dict[str, object]:
    """Settings as YAML gives them, in the types the config wants. Raises CameraError."""
    try:
        return {key: _converted(key, value) for key, value in values.items()}
    except (TypeError, ValueError, CameraError) as error:
        raise CameraError(f"camera '{name}': {error}") from None


def _converted(key: str, value: object) -> object:
    if key == "effects":
        if isinstance(value, Effects):
            return value
        if not isinstance(value, Mapping):
            raise TypeError(f"effects {value!r}: give keys with values, as noise_stddev: 5.0")
        return Effects.from_mapping(value)
    if key in ("camera_matrix", "cutoff_angle") and value is None:
        return None
    if key == "camera_matrix" and isinstance(value, Mapping):
        if set(value) != {"fx", "fy", "cx", "cy"}:
            raise TypeError(f"camera_matrix has the keys {sorted(value)}; give fx, fy, cx, cy")
        value = [value[k] for k in ("fx", "fy", "cx", "cy")]
    if key in _LISTS:
        return _numbers(key, value, _LISTS[key])
    if key in _NUMBERS:
        if not is_number(value):
            raise TypeError(f"{key} {value!r} is not a number{hint(value)}")
        return float(value)
    if key in _WHOLE and (not isinstance(value, int) or isinstance(value, bool)):
        raise TypeError(f"{key} {value!r} is not a whole number")
    if key in _TRUTHS and not isinstance(value, bool):
        raise TypeError(f"{key} {value!r} is neither true nor false")
    if key not in _WHOLE | _TRUTHS and not isinstance(value, str):
        raise TypeError(f"{key} {value!r} is not a text")
    return value


def _numbers(key: str, value: object, count: int | None) -> tuple[float, ...]:
    """A list, or a text such as '0 0 0.05' from a launch argument, as finite numbers."""
    items = value.split() if isinstance(value, str) else value
    wanted = "finite numbers" if count is None else f"{count} finite numbers"
    try:
        numbers = tuple(float(item) for item in items)
    except (TypeError, ValueError):
        numbers = (math.nan,)
    if not all(map(math.isfinite, numbers)) or (count is not None and len(numbers) != count):
        raise TypeError(f"{key} {value!r}: give {wanted}")
    return numbers
