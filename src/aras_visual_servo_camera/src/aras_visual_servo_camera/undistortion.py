"""From pixels to normalised coordinates, by CameraInfo: pinhole, plumb_bob, rational, fisheye.

A distorted image is not resampled. Each pixel keeps its value and gets, once per camera, the
undistorted place of its centre and the area that its square is mapped to. Sums over pixels then
are exact in area, whatever the lens.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aras_visual_servo_base.lenses import (
    brown,
    extrapolate_brown,
    extrapolate_kannala_brandt,
    fold_radius,
    kannala_brandt,
    kannala_brandt_fold,
)

from .errors import CalibrationError
from .moments import Pinhole
from .polygons import Array

PINHOLE_MODELS = ("", "plumb_bob", "rational_polynomial")
FISHEYE_MODELS = ("equidistant", "fisheye")

# A ray further than this off the axis has no finite x = X/Z worth the name.
_MAX_FIELD_ANGLE = np.deg2rad(88.0)


class PixelTables(NamedTuple):
    """Undistorted x, y of each pixel's centre and its area, all (rows, columns); area 0: no ray."""

    x: Array
    y: Array
    area: Array

    def compute_pixel_variance(self, column: int, row: int) -> tuple[float, float, float]:
        """Variance (xx, xy, yy) of one pixel's square, mapped to normalised coordinates."""
        rows, columns = self.area.shape
        c0, c1 = max(column - 1, 0), min(column + 1, columns - 1)
        r0, r1 = max(row - 1, 0), min(row + 1, rows - 1)
        across = np.array([t[row, c1] - t[row, c0] for t in (self.x, self.y)]) / max(c1 - c0, 1)
        down = np.array([t[r1, column] - t[r0, column] for t in (self.x, self.y)]) / max(r1 - r0, 1)
        # a unit square has variance 1/12 along each of its sides
        variance = (np.outer(across, across) + np.outer(down, down)) / 12.0
        return float(variance[0, 0]), float(variance[0, 1]), float(variance[1, 1])


@dataclass(frozen=True)
class CameraModel:
    """Intrinsics and distortion of one camera; `project` and `normalise` map rays and pixels.

    Attributes:
        width, height: of the image, px.
        K: camera matrix, 9 numbers row by row, px.
        D: distortion coefficients, as in sensor_msgs/CameraInfo.
        model: distortion model, as in sensor_msgs/CameraInfo.

    Raises:
        CalibrationError: unknown model, or numbers that no camera has.
    """

    width: int
    height: int
    K: tuple[float, ...]
    D: tuple[float, ...] = ()
    model: str = "plumb_bob"

    def __post_init__(self) -> None:
        if self.model not in PINHOLE_MODELS + FISHEYE_MODELS:
            raise CalibrationError(
                f"distortion model '{self.model}' is not known; use one of "
                f"{PINHOLE_MODELS[1:] + FISHEYE_MODELS}"
            )
        if len(self.K) != 9 or not np.isfinite(self.K).all() or not np.isfinite(self.D).all():
            raise CalibrationError("camera_info: K needs 9 finite numbers, D finite ones")
        if not (self.K[0] > 0.0 and self.K[4] > 0.0):
            raise CalibrationError(
                f"camera_info: focal lengths fx={self.K[0]:g}, fy={self.K[4]:g} must be positive; "
                "is the camera calibrated?"
            )
        if self.K[1] != 0.0:
            raise CalibrationError(f"camera_info: skew K[1]={self.K[1]:g} is not supported")
        if self.width < 1 or self.height < 1:
            raise CalibrationError(f"camera_info: size {self.width} x {self.height} is empty")
        allowed = (0, 4) if self.model in FISHEYE_MODELS else (0, 4, 5, 8, 12, 14)
        if len(self.D) not in allowed:
            raise CalibrationError(
                f"camera_info: '{self.model}' takes {allowed} coefficients, got {len(self.D)}"
            )

    @classmethod
    def from_message(cls, info: Any) -> CameraModel:
        """From a sensor_msgs/CameraInfo (anything with its attributes)."""
        return cls(
            int(info.width),
            int(info.height),
            tuple(float(k) for k in info.K),
            tuple(float(d) for d in info.D),
            str(info.distortion_model),
        )

    @cached_property
    def pinhole(self) -> Pinhole:
        """Focal lengths and principal point, without the distortion."""
        return Pinhole.from_K(self.K)

    @cached_property
    def is_distorted(self) -> bool:
        """True if pixels need the tables; a fisheye lens does even with D = 0."""
        return self.model in FISHEYE_MODELS or any(self.D)

    @cached_property
    def tables(self) -> PixelTables:
        """Per-pixel tables, worked out when first asked for."""
        u, v = np.meshgrid(np.arange(self.width), np.arange(self.height))
        x, y, valid = self.normalise(u.ravel(), v.ravel())
        shape = (self.height, self.width)
        x, y, valid = x.reshape(shape), y.reshape(shape), valid.reshape(shape)
        cu, cv = np.meshgrid(np.arange(self.width + 1) - 0.5, np.arange(self.height + 1) - 0.5)
        corner = self.normalise(cu.ravel(), cv.ravel())
        cx, cy, cvalid = (a.reshape(self.height + 1, self.width + 1) for a in corner)
        # a quadrilateral's area is half the cross product of its diagonals
        dx1, dy1 = cx[1:, 1:] - cx[:-1, :-1], cy[1:, 1:] - cy[:-1, :-1]
        dx2, dy2 = cx[1:, :-1] - cx[:-1, 1:], cy[1:, :-1] - cy[:-1, 1:]
        area = 0.5 * (dx1 * dy2 - dy1 * dx2)
        valid &= cvalid[1:, 1:] & cvalid[:-1, :-1] & cvalid[1:, :-1] & cvalid[:-1, 1:]
        valid &= area > 0.0
        return PixelTables(
            np.where(valid, x, 0.0), np.where(valid, y, 0.0), np.where(valid, area, 0.0)
        )

    @cached_property
    def blind_mask(self) -> NDArray[np.bool_] | None:
        """(rows, columns), True where pixels have no normalised coordinates; None: nowhere."""
        if not self.is_distorted:
            return None
        blind = self.tables.area <= 0.0
        return blind if blind.any() else None

    def normalise(self, u: Array, v: Array) -> tuple[Array, Array, Array]:
        """Undistorted x, y (n,) of pixel places u (column), v (row), and where that worked."""
        camera = self.pinhole
        xd = (np.asarray(u, dtype=float) - camera.cx) / camera.fx
        yd = (np.asarray(v, dtype=float) - camera.cy) / camera.fy
        if not self.is_distorted:
            return xd, yd, np.ones(xd.shape, dtype=bool)
        if self.model in FISHEYE_MODELS:
            return _undistort_fisheye(xd, yd, self.D or (0.0,) * 4)
        return _undistort_polynomial(xd, yd, self.D)

    def project(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Pixel places (column, row) of normalised x, y (n,), with the distortion."""
        x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
        if self.is_distorted:
            if self.model in FISHEYE_MODELS:
                x, y = _distort_fisheye(x, y, self.D or (0.0,) * 4)
            else:
                x, y = extrapolate_brown(x, y, self.D)
        camera = self.pinhole
        return camera.fx * x + camera.cx, camera.fy * y + camera.cy


def normalise_pixels(
    pixels: Array, camera: CameraModel, assumed: CameraModel, is_closed: bool = False
) -> Array:
    """Normalised points (n, 2) that an assumed camera makes of pixels of the true one.

    Args:
        pixels: (n, 2) of `camera`, px. assumed: the calibration by which they are read.
        closed: whether they are an outline, whose straight edges another lens would bend: it gets
            points along them.

    Returns:
        NaN where the assumed camera has no ray.
    """
    if is_closed and camera != assumed and (camera.is_distorted or assumed.is_distorted):
        x, y, _ = camera.normalise(*pixels.T)
        pixels = np.column_stack(camera.project(*subdivide(np.column_stack([x, y])).T))
    x, y, valid = assumed.normalise(*pixels.T)
    return np.column_stack([np.where(valid, x, np.nan), np.where(valid, y, np.nan)])


def subdivide(outline: Array, parts: int = 8) -> Array:
    """The outline (n, 2) with `parts` points on each edge, so that a lens may bend its edges."""
    ends = np.roll(outline, -1, axis=0)
    steps = (np.arange(parts) / parts)[None, :, None]
    return (outline[:, None] + steps * (ends - outline)[:, None]).reshape(-1, 2)


def _undistort_polynomial(xd: Array, yd: Array, D: tuple[float, ...]):
    """Newton's method on both coordinates; a place that does not settle has no ray."""
    x, y = xd.copy(), yd.copy()
    with np.errstate(all="ignore"):
        for _ in range(30):
            px, py, jxx, jxy, jyx, jyy = brown(x, y, D)
            ex, ey = px - xd, py - yd
            if float(np.nanmax(np.abs(ex) + np.abs(ey))) < 1e-14:
                break
            determinant = jxx * jyy - jxy * jyx
            x = x - (jyy * ex - jxy * ey) / determinant
            y = y - (jxx * ey - jyx * ex) / determinant
        px, py, jxx, jxy, jyx, jyy = brown(x, y, D)
        valid = np.abs(px - xd) + np.abs(py - yd) < 1e-10
        # beyond a fold a root on the far side of the axis mirrors twice: its Jacobian is negative
        valid &= (jxx * jyy - jxy * jyx > 0.0) & (jxx + jyy > 0.0)
        # nor does a root beyond the fold lie on the branch that starts at the axis
        valid &= x * x + y * y < min(np.tan(_MAX_FIELD_ANGLE), fold_radius(D)) ** 2
    return np.where(valid, x, 0.0), np.where(valid, y, 0.0), valid


def _distort_fisheye(x: Array, y: Array, D: tuple[float, ...]):
    r = np.hypot(x, y)
    rd = extrapolate_kannala_brandt(np.arctan(r), D)
    scale = np.divide(rd, r, out=np.ones_like(r), where=r > 0.0)
    return x * scale, y * scale


def _undistort_fisheye(xd: Array, yd: Array, D: tuple[float, ...]):
    rd = np.hypot(xd, yd)
    theta = rd.copy()
    with np.errstate(all="ignore"):
        for _ in range(30):
            value, slope = kannala_brandt(theta, D)
            step = (value - rd) / slope
            theta = theta - step
            if float(np.nanmax(np.abs(step))) < 1e-15:
                break
        valid = (np.abs(step) < 1e-10) & (slope > 0.0) & (theta >= 0.0)
        valid &= theta < min(_MAX_FIELD_ANGLE, kannala_brandt_fold(D))
        scale = np.where(rd > 0.0, np.tan(theta) / np.where(rd > 0.0, rd, 1.0), 1.0)
    return np.where(valid, xd * scale, 0.0), np.where(valid, yd * scale, 0.0), valid
