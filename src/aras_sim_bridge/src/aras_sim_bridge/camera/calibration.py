"""Intrinsic calibration of a camera, with checks and a conversion to settings of CameraConfig."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from aras_visual_servo_base.setting_values import format_value

from ..errors import CameraError
from .lens import COEFFICIENTS

# Names of the distortion models of sensor_msgs/CameraInfo, by the names that calibration programs
# write.
MODELS = {
    "plumb_bob": "plumb_bob", "radtan": "plumb_bob", "rational_polynomial": "rational_polynomial",
    "equidistant": "equidistant", "fisheye": "equidistant", "none": "plumb_bob", "": "plumb_bob",
}  # fmt: skip
# Valid range of the principal point, as a fraction of the image's width or height. Real lenses are
# centred to within some per cent. If the point is outside this range, the camera matrix belongs to
# another resolution.
CENTRE_RANGE = (0.3, 0.7)
LARGEST_ASPECT = 1.5  # largest valid ratio of a pixel's sides; 1.46 occurs in analogue video


@dataclass(frozen=True)
class Calibration:
    """Intrinsics and distortion of one camera, as read from a file.

    Attributes:
        where: file and name of the camera, for messages.
        width, height: image size, px; None if the file does not contain it.
        matrix: (9,) camera matrix, row by row, px.
        model: name of the distortion model as in CameraInfo; None for OpenCV's files, which do not
            name the model. The number of coefficients then determines the model.
        D: distortion coefficients in OpenCV's order.
        R, P: the matrices R (9 numbers) and P (12 numbers) of CameraInfo, row by row; None if the
            file does not contain them.

    Raises:
        CameraError: a number is invalid, or the image size, the camera matrix and the coefficients
            do not fit each other.
    """

    where: str
    width: int | None
    height: int | None
    matrix: tuple[float, ...]
    model: str | None
    D: tuple[float, ...]
    R: tuple[float, ...] | None = None
    P: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            value = getattr(self, name)
            self._check(value is None or value >= 1,
                        f"image_{name} is {value}, must be at least 1 px")
        self._check_matrix()
        if self.model is None:
            names = {n: model for model, counts in COEFFICIENTS.items()
                     if model != "equidistant" for n in counts}  # fmt: skip
            self._check(len(self.D) in (0, *names),
                        f"distortion_coefficients has {len(self.D)} numbers, must have "
                        f"{', '.join(map(str, sorted(names)))} or 0 numbers")
            object.__setattr__(self, "model", names.get(len(self.D), "plumb_bob"))
        self._check_coefficients()

    def to_settings(self) -> dict[str, Any]:
        """Return the settings of CameraConfig that describe the lens and the image size."""
        found: dict[str, Any] = {
            "lens": "pinhole" if self.model != "equidistant" else "equidistant",
            "camera_matrix": [self.matrix[i] for i in (0, 4, 2, 5)],
            "distortion_model": self.model,
            "distortion_coefficients": list(self.D),
        }
        for name in ("width", "height"):
            if getattr(self, name) is not None:
                found[name] = getattr(self, name)
        if self.R is not None:
            found["rectification_matrix"] = list(self.R)
        if self.P is not None:
            found["projection_matrix"] = list(self.P)
        return found

    def _check_matrix(self) -> None:
        fx, skew, cx, zero, fy, cy, *last = self.matrix
        self._check(fx > 0.0 and fy > 0.0,
                    f"focal lengths of the camera matrix are {fx:g} and {fy:g} px, must be above "
                    "0: calibrate the camera")
        self._check(skew == zero == 0.0,
                    f"the camera matrix has a skew of {(skew or zero):g} px, which is not "
                    "supported: calibrate without skew")
        self._check(last == [0.0, 0.0, 1.0],
                    f"the last row of the camera matrix is {last}, must be [0, 0, 1]: "
                    "correct the camera matrix")
        self._check(1.0 / LARGEST_ASPECT < fx / fy < LARGEST_ASPECT,
                    f"the camera matrix has fx = {fx:g} and fy = {fy:g} px: a pixel would be "
                    f"{fx / fy:.3g} times as high as wide; correct the camera matrix")
        for name, side, centre, axis in (
            ("width", self.width, cx, "cx"), ("height", self.height, cy, "cy")
        ):  # fmt: skip
            low, high = CENTRE_RANGE
            self._check(
                side is None or low * side <= centre <= high * side,
                f"{axis} = {centre:g} px in the camera matrix is far from the centre of an image "
                f"with image_{name} {side} px; set the image size for which the camera matrix was "
                "calibrated (for a cropped image, set width, height and camera_matrix in a "
                "preset)",
            )

    def _check_coefficients(self) -> None:
        counts = COEFFICIENTS[self.model]
        fits = [name for name, number in COEFFICIENTS.items() if len(self.D) in number]
        other = f", or set distortion_model to {' or '.join(fits)}" if fits else ""
        self._check(
            len(self.D) in (0, *counts),
            f"distortion_coefficients has {len(self.D)} numbers, but distortion_model {self.model} "
            f"needs {' or '.join(map(str, counts))}: correct distortion_coefficients{other}",
        )

    def _check(self, condition: bool, message: str) -> None:
        if not condition:
            raise CameraError(f"{self.where}: {message}")


def find_distortion_model(name: Any, where: str) -> str:
    """Return the name in CameraInfo of the distortion model that a calibration file calls `name`.

    Raises:
        CameraError: the model is not supported.
    """
    known = str(name).strip().lower()
    if known not in MODELS:
        raise CameraError(
            f"{where}: distortion_model {format_value(name)} is not supported; calibrate with "
            f"one of {', '.join(model for model in MODELS if model)}"
        )
    return MODELS[known]


def check_finite(values: Any, where: str, counts: Sequence[int] = ()) -> tuple[float, ...]:
    """Check that `values` is a list of finite numbers, and return them as floats.

    `counts` contains the allowed lengths of the list; if it is empty, any length is allowed.
    `where` names the list in error messages.

    Raises:
        CameraError: a value is not a finite number, or the length is not allowed.
    """
    expected = f"{' or '.join(map(str, counts))} finite numbers" if counts else "finite numbers"
    fits = isinstance(values, list | tuple) and all(
        isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) for v in values
    )
    if not fits or counts and len(values) not in counts:
        raise CameraError(f"{where} is {format_value(values)}, must be {expected}")
    return tuple(map(float, values))
