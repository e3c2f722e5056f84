"""Conversion between pixels and normalised coordinates by the lens model of a CameraInfo.

The supported models are the pinhole camera, plumb_bob, rational_polynomial and the fisheye model.

Instead of resampling distorted images, the module computes once for each camera where the centre of
each pixel is in normalised coordinates, and which area the pixel has there. Moments are sums over
pixels with these areas.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aras_visual_servo_base.lenses import (
    extrapolate_brown,
    extrapolate_kannala_brandt,
    kannala_brandt,
    kannala_brandt_fold,
    undistort_brown,
)
from aras_visual_servo_base.memory import ByteLimitedCache

from .errors import InvalidIntrinsicsError
from .moments import Pinhole
from .polygons import Array

PINHOLE_MODELS = ("", "plumb_bob", "rational_polynomial")
FISHEYE_MODELS = ("equidistant", "fisheye")

# Size of the cached tables of recently used cameras, bytes. The tables of a camera with 640 x 480
# px take 7 MB.
CACHE_BYTES = 64_000_000
# Rays at a larger angle to the optical axis are rejected, because x = X/Z is infinite at 90 deg.
_MAX_FIELD_ANGLE = np.deg2rad(88.0)


class PixelTables(NamedTuple):
    """Undistorted position and area of each pixel in normalised coordinates.

    Attributes:
        x, y: (rows, columns) position of the pixel's centre.
        area: (rows, columns) area of the pixel's square, 0 outside the range of the lens model.
    """

    x: Array
    y: Array
    area: Array

    def compute_pixel_variance(self, column: int, row: int) -> tuple[float, float, float]:
        """Compute the variances and the covariance of normalised x and y over one pixel.

        Returns:
            Variance of x, covariance, variance of y.
        """
        rows, columns = self.area.shape
        c0, c1 = max(column - 1, 0), min(column + 1, columns - 1)
        r0, r1 = max(row - 1, 0), min(row + 1, rows - 1)
        across = np.array([t[row, c1] - t[row, c0] for t in (self.x, self.y)]) / max(c1 - c0, 1)
        down = np.array([t[r1, column] - t[r0, column] for t in (self.x, self.y)]) / max(r1 - r0, 1)
        # The variance of points that are distributed uniformly in a unit square is 1/12 along each
        # side.
        variance = (np.outer(across, across) + np.outer(down, down)) / 12.0
        return float(variance[0, 0]), float(variance[0, 1]), float(variance[1, 1])


@dataclass(frozen=True)
class CameraModel:
    """Intrinsics and distortion of one camera.

    `project` converts normalised coordinates to pixels, `normalise` converts pixels to normalised
    coordinates.

    Attributes:
        width, height: size of the image, px.
        K: camera matrix, 9 numbers row by row, px.
        D: distortion coefficients, as in sensor_msgs/CameraInfo.
        model: name of the distortion model, as in sensor_msgs/CameraInfo.

    Raises:
        InvalidIntrinsicsError: the model is unknown, or a number is invalid.
    """

    width: int
    height: int
    K: tuple[float, ...]
    D: tuple[float, ...] = ()
    model: str = "plumb_bob"

    def __post_init__(self) -> None:
        if self.model not in PINHOLE_MODELS + FISHEYE_MODELS:
            raise InvalidIntrinsicsError(
                f"distortion model '{self.model}' is not known; use one of "
                f"{', '.join(PINHOLE_MODELS[1:] + FISHEYE_MODELS)}"
            )
        if len(self.K) != 9 or not np.isfinite(self.K).all() or not np.isfinite(self.D).all():
            raise InvalidIntrinsicsError(
                "camera_info: K must contain 9 finite numbers, and all numbers in D must be finite"
            )
        if not (self.K[0] > 0.0 and self.K[4] > 0.0):
            raise InvalidIntrinsicsError(
                f"camera_info: focal lengths fx={self.K[0]:g}, fy={self.K[4]:g} must be positive; "
                "calibrate the camera"
            )
        if self.K[1] != 0.0:
            raise InvalidIntrinsicsError(
                f"camera_info: the skew K[1] is {self.K[1]:g}, must be 0; calibrate without skew"
            )
        if self.width < 1 or self.height < 1:
            raise InvalidIntrinsicsError(
                f"camera_info: size {self.width} x {self.height} is empty, must be at least 1 x 1"
            )
        allowed = (0, 4) if self.model in FISHEYE_MODELS else (0, 4, 5, 8, 12, 14)
        if len(self.D) not in allowed:
            raise InvalidIntrinsicsError(
                f"camera_info: D has {len(self.D)} coefficients; distortion model '{self.model}' "
                f"needs {', '.join(map(str, allowed[:-1]))} or {allowed[-1]}"
            )

    @classmethod
    def from_message(cls, info: Any) -> CameraModel:
        """Return the model of a sensor_msgs/CameraInfo, or of an object with its attributes."""
        K, D = tuple(map(float, info.K)), tuple(map(float, info.D))
        return cls(int(info.width), int(info.height), K, D, str(info.distortion_model))

    @cached_property
    def pinhole(self) -> Pinhole:
        """Focal lengths and principal point of the camera without its distortion."""
        return Pinhole.from_K(self.K)

    @cached_property
    def is_distorted(self) -> bool:
        """True if the lens has distortion; a fisheye lens has distortion even if D = 0."""
        return self.model in FISHEYE_MODELS or any(self.D)

    @cached_property
    def tables(self) -> PixelTables:
        """Undistorted position and area of each pixel, computed at first use; read-only.

        All cameras of a process with the same calibration share these tables, because a study
        creates a new camera for each run.
        """
        return _tables.get(self, lambda: _compute_tables(self))

    @cached_property
    def blind_mask(self) -> NDArray[np.bool_] | None:
        """Mask (rows, columns) of the pixels outside the lens model's range; None if all are in it.
        """
        if not self.is_distorted:
            return None
        blind = self.tables.area <= 0.0
        return blind if blind.any() else None

    def normalise(self, u: Array, v: Array) -> tuple[Array, Array, Array]:
        """Convert pixels to normalised coordinates.

        Args:
            u, v: (n,) column and row of each pixel.

        Returns:
            x (n,); y (n,); and for each pixel whether it is in the range of the lens model (n,). If
            it is not, x and y are 0.
        """
        camera = self.pinhole
        xd = (np.asarray(u, dtype=float) - camera.cx) / camera.fx
        yd = (np.asarray(v, dtype=float) - camera.cy) / camera.fy
        if not self.is_distorted:
            valid = np.empty(xd.shape, bool)
            valid.fill(True)
            return xd, yd, valid
        if self.model in FISHEYE_MODELS:
            return _undistort_fisheye(xd, yd, self.D or (0.0,) * 4)
        return undistort_brown(xd, yd, self.D, np.tan(_MAX_FIELD_ANGLE))

    def project(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Convert normalised coordinates x, y, (n,) each, to pixels (column, row), (n,) each."""
        x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
        if self.is_distorted:
            if self.model in FISHEYE_MODELS:
                x, y = _distort_fisheye(x, y, self.D or (0.0,) * 4)
            else:
                x, y = extrapolate_brown(x, y, self.D)
        camera = self.pinhole
        return camera.fx * x + camera.cx, camera.fy * y + camera.cy

    def project_points(self, points: Array) -> Array:
        """Convert normalised points (n, 2) to pixels (n, 2)."""
        if self.is_distorted:
            return np.column_stack(self.project(*points.T))
        scale, centre = self._scale_and_centre
        return scale * points + centre

    @cached_property
    def _scale_and_centre(self) -> tuple[Array, Array]:
        """Focal lengths (2,) and principal point (2,), px."""
        camera = self.pinhole
        return np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])


_tables: ByteLimitedCache[CameraModel, PixelTables] = ByteLimitedCache(
    CACHE_BYTES, lambda tables: sum(table.nbytes for table in tables)
)


def _compute_tables(camera: CameraModel) -> PixelTables:
    width, height = camera.width, camera.height
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    x, y, valid = (a.reshape(height, width) for a in camera.normalise(u.ravel(), v.ravel()))
    cu, cv = np.meshgrid(np.arange(width + 1) - 0.5, np.arange(height + 1) - 0.5)
    corner = camera.normalise(cu.ravel(), cv.ravel())
    cx, cy, cvalid = (a.reshape(height + 1, width + 1) for a in corner)
    # The area of a quadrilateral is half the cross product of its diagonals.
    dx1, dy1 = cx[1:, 1:] - cx[:-1, :-1], cy[1:, 1:] - cy[:-1, :-1]
    dx2, dy2 = cx[1:, :-1] - cx[:-1, 1:], cy[1:, :-1] - cy[:-1, 1:]
    area = 0.5 * (dx1 * dy2 - dy1 * dx2)
    valid &= cvalid[1:, 1:] & cvalid[:-1, :-1] & cvalid[1:, :-1] & cvalid[:-1, 1:]
    valid &= area > 0.0
    tables = PixelTables(*(np.where(valid, table, 0.0) for table in (x, y, area)))
    for table in tables:
        table.setflags(write=False)
    return tables


def normalise_pixels(
    pixels: Array, camera: CameraModel, assumed: CameraModel, is_closed: bool = False
) -> Array:
    """Convert pixels of a camera to normalised coordinates, with an assumed calibration.

    Args:
        pixels: (n, 2) px (column, row).
        camera: true calibration of the camera.
        assumed: calibration that is used to normalise the pixels.
        is_closed: True if the pixels are the corners of a closed outline. If the two calibrations
            differ, the edges between the corners become curved, so points are added on each edge.

    Returns:
        (m, 2) normalised points; NaN for a pixel outside the range of the assumed lens model.
    """
    if is_closed and (camera.is_distorted or assumed.is_distorted) and camera != assumed:
        x, y, _ = camera.normalise(*pixels.T)
        pixels = camera.project_points(subdivide(np.column_stack([x, y])))
    if not assumed.is_distorted:
        scale, centre = assumed._scale_and_centre
        return (pixels - centre) / scale
    x, y, valid = assumed.normalise(*pixels.T)
    return np.column_stack([np.where(valid, x, np.nan), np.where(valid, y, np.nan)])


def subdivide(outline: Array, parts: int = 8) -> Array:
    """Divide each edge of a closed outline (n, 2) into `parts` equal parts.

    The result (n * parts, 2) can represent edges that a lens bends.
    """
    ends = np.roll(outline, -1, axis=0)
    steps = (np.arange(parts) / parts)[None, :, None]
    return (outline[:, None] + steps * (ends - outline)[:, None]).reshape(-1, 2)


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
