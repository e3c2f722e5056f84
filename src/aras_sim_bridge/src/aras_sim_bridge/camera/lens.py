"""Lenses: where a ray lands on the image plane at unit focal length, and back.

Brown's model with a rational radial part ('plumb_bob', 'rational_polynomial') and Kannala and
Brandt's ('equidistant') follow OpenCV's calib3d and fisheye modules, coefficient by coefficient.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from aras_visual_servo_base.lenses import brown, fold_radius, kannala_brandt

from ..errors import CameraError

# Angle from the optical axis up to which each lens has an image, rad; the pinhole stays below.
LARGEST_ANGLE = {
    "pinhole": math.radians(90.0),
    "equidistant": math.radians(110.0),
    "stereographic": math.radians(110.0),
    "equisolid": math.radians(110.0),
    "orthographic": math.radians(90.0),
}
# Radius in the image at unit focal length, of the angle from the optical axis.
RADIUS_FUNCTION: dict[str, Callable] = {
    "pinhole": np.tan,
    "equidistant": lambda theta: theta,
    "stereographic": lambda theta: 2.0 * np.tan(theta / 2.0),
    "equisolid": lambda theta: 2.0 * np.sin(theta / 2.0),
    "orthographic": np.sin,
}
COEFFICIENTS = {"plumb_bob": (4, 5), "rational_polynomial": (8, 12, 14), "equidistant": (4,)}


@dataclass(frozen=True)
class BrownLens:
    """Pinhole with Brown's distortion; D as in lenses.brown, 5 or more."""

    D: tuple[float, ...]

    def project(self, rays: np.ndarray) -> np.ndarray:
        """Distorted (N, 2) coordinates of rays (N, 3) with z > 0; NaN behind the camera."""
        z = np.where(rays[:, 2] > 0.0, rays[:, 2], np.nan)
        return self.distort(rays[:, :2] / z[:, None])[0]

    def unproject(self, points: np.ndarray) -> np.ndarray:
        """Unit rays (N, 3) of distorted coordinates (N, 2); NaN where there is none.

        Newton's method from the centre outwards: the answer of the branch that starts at the
        optical axis, or none beyond the radius where the distortion folds over.
        """
        flat = not any(self.D)
        x = np.array(points, dtype=float)
        good = np.ones(len(x), bool)
        if not flat:
            # Following the solution as the target moves outwards keeps Newton on the branch.
            x = np.zeros_like(x)
            for share, most in ((0.25, 2), (0.5, 2), (0.75, 2), (1.0, 20)):
                x = x + 0.25 * points
                for _ in range(most):
                    value, a, b, c, d = self.distort(x)
                    error = value - share * points
                    if np.abs(error).max(initial=0.0) < 1e-13:
                        break
                    det = a * d - b * c
                    det = np.where(np.abs(det) > 1e-9, det, 1e-9)
                    step = np.stack([d * error[:, 0] - b * error[:, 1],
                                     a * error[:, 1] - c * error[:, 0]], axis=1) / det[:, None]
                    x = x - np.clip(step, -0.5, 0.5)
            value, a, b, c, d = self.distort(x)
            good = (np.abs(value - points).max(axis=1) < 1e-9) & (a * d - b * c > 0) & (a > 0)
            good &= np.hypot(*x.T) < self.fold_radius()
        rays = np.concatenate([x, np.ones((len(x), 1))], axis=1)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        rays[~good] = np.nan
        return rays

    def fold_radius(self) -> float:
        """See lenses.fold_radius."""
        return fold_radius(self.D)

    def distort(self, p: np.ndarray) -> tuple[np.ndarray, ...]:
        """Distorted points (N, 2) and the entries of the Jacobian [[a, b], [c, d]], each (N,)."""
        x, y, *jacobian = brown(*p.T, self.D)
        return np.stack([x, y], axis=1), *jacobian


@dataclass(frozen=True)
class FisheyeLens:
    """Kannala and Brandt: radius = t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8), t from the axis.

    cutoff: angle beyond which the image is black, rad.
    """

    D: tuple[float, ...]
    cutoff: float

    def radius(self, theta: np.ndarray) -> np.ndarray:
        """Distance from the image's centre at unit focal length, of angles from the axis, rad."""
        return kannala_brandt(theta, self.D)[0]

    def slope(self, theta: np.ndarray) -> np.ndarray:
        """Derivative of the radius with the angle, at angles from the axis, rad."""
        return kannala_brandt(theta, self.D)[1]

    def project(self, rays: np.ndarray) -> np.ndarray:
        """Image coordinates (N, 2) of rays (N, 3) in any direction."""
        rho = np.hypot(rays[:, 0], rays[:, 1])
        r = self.radius(np.arctan2(rho, rays[:, 2]))
        scale = np.divide(r, rho, out=np.zeros_like(r), where=rho > 0)
        return rays[:, :2] * scale[:, None]

    def unproject(self, points: np.ndarray) -> np.ndarray:
        """Unit rays (N, 3) of image coordinates (N, 2); NaN beyond the cutoff."""
        r = np.hypot(points[:, 0], points[:, 1])
        limit = float(self.radius(self.cutoff))
        inside = r <= limit
        target = np.where(inside, r, 0.0)
        # Monotonic on [0, cutoff] (checked by the config): bisection's bracket, Newton's speed.
        low, high = np.zeros_like(r), np.full_like(r, self.cutoff)
        theta = np.clip(target, 0.0, self.cutoff)
        for _ in range(60):
            error = self.radius(theta) - target
            high, low = np.where(error > 0, theta, high), np.where(error > 0, low, theta)
            new = theta - error / np.maximum(self.slope(theta), 1e-9)
            # The angle is one of the bounds. A step of more than half the way to the other one may
            # go to and fro between them; an exact angle must not be left again.
            new = np.where(np.abs(new - theta) <= (high - low) / 2, new, (low + high) / 2)
            done = np.abs(new - theta).max(initial=0.0) < 1e-14
            theta = new
            if done:
                break
        sine = np.divide(np.sin(theta), r, out=np.zeros_like(r), where=r > 0)
        rays = np.concatenate([points * sine[:, None], np.cos(theta)[:, None]], axis=1)
        rays[~inside] = np.nan
        return rays


def fit_fisheye(lens: str, cutoff: float) -> tuple[float, float, float, float]:
    """Kannala-Brandt coefficients of an ideal wide-angle projection, fitted up to `cutoff` rad.

    ROS and OpenCV have no name for these projections. Their radius is an odd function of the angle
    and four coefficients give it to better than 1e-4 of the focal length, so the picture is drawn
    with the very coefficients that CameraInfo publishes.
    """
    if lens == "equidistant":
        return (0.0, 0.0, 0.0, 0.0)
    # Chebyshev nodes keep the largest error of the fit small.
    t = cutoff * np.sin(np.linspace(0.0, np.pi / 2, 400)[1:])
    basis = np.stack([t**3, t**5, t**7, t**9], axis=1)
    fit, *_ = np.linalg.lstsq(basis, RADIUS_FUNCTION[lens](t) - t, rcond=None)
    return tuple(float(k) for k in fit)


def check_fisheye(lens: FisheyeLens, name: str) -> None:
    """Raise CameraError when the radius stops growing before the cutoff."""
    theta = np.linspace(0.0, lens.cutoff, 2000)
    falling = lens.slope(theta) <= 0
    if falling.any():
        at = math.degrees(float(theta[falling.argmax()]))
        raise CameraError(
            f"camera '{name}': distortion_coefficients {list(lens.D)} fold the picture over at "
            f"{at:.1f} deg from the axis; lower cutoff_angle below it or correct the coefficients"
        )
