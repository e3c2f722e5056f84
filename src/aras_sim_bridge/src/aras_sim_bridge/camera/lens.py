"""Lens models: projection of rays to the image plane at unit focal length, and its inverse.

Brown's model ('plumb_bob' and, with a rational radial part, 'rational_polynomial') has the
coefficients of OpenCV's module calib3d. The model of Kannala and Brandt ('equidistant') has the
coefficients of OpenCV's module fisheye.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from aras_visual_servo_base.lenses import brown, fold_radius, kannala_brandt

from ..errors import CameraError

# Largest angle between a ray and the optical axis for each lens, rad. For a pinhole, the
# angle must be smaller than this value.
LARGEST_ANGLE = {
    "pinhole": math.radians(90.0),
    "equidistant": math.radians(110.0),
    "stereographic": math.radians(110.0),
    "equisolid": math.radians(110.0),
    "orthographic": math.radians(90.0),
}
# Distance of an image point from the principal point at unit focal length, as a function of the
# angle between the ray and the optical axis, rad.
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
    """Pinhole with Brown's distortion.

    Attributes:
        D: coefficients k1, k2, p1, p2, k3 and up to 9 more in OpenCV's order.
    """

    D: tuple[float, ...]

    def project(self, rays: np.ndarray) -> np.ndarray:
        """Return the distorted coordinates (N, 2) of rays (N, 3); NaN for rays with z <= 0."""
        z = np.where(rays[:, 2] > 0.0, rays[:, 2], np.nan)
        return self.distort(rays[:, :2] / z[:, None])[0]

    def unproject(self, points: np.ndarray) -> np.ndarray:
        """Return the unit rays (N, 3) of distorted coordinates (N, 2); NaN if there is no solution.

        If several rays have the same distorted coordinates, the result is the ray nearest to the
        optical axis: the one whose undistorted radius is below `fold_radius`.
        """
        flat = not any(self.D)
        x = np.array(points, dtype=float)
        good = np.ones(len(x), bool)
        if not flat:
            # Move each point in four steps from the image centre to its position, and solve after
            # each step, so that Newton's method follows the right solution.
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
        """Return the undistorted radius at which the distorted radius stops increasing, or inf."""
        return fold_radius(self.D)

    def distort(self, p: np.ndarray) -> tuple[np.ndarray, ...]:
        """Distort the points p (N, 2).

        Return the distorted points (N, 2), and the entries a, b, c, d, each (N,), of the Jacobian
        [[a, b], [c, d]].
        """
        x, y, *jacobian = brown(*p.T, self.D)
        return np.stack([x, y], axis=1), *jacobian


@dataclass(frozen=True)
class FisheyeLens:
    """Fisheye model of Kannala and Brandt.

    A ray at the angle t from the optical axis has the image radius t (1 + k1 t^2 + k2 t^4 + k3 t^6
    + k4 t^8) at unit focal length.

    Attributes:
        D: coefficients k1 to k4.
        cutoff: angle beyond which the image is black, rad.
    """

    D: tuple[float, ...]
    cutoff: float

    def radius(self, theta: np.ndarray) -> np.ndarray:
        """Return the image radius, at unit focal length, of rays at `theta` rad from the axis."""
        return kannala_brandt(theta, self.D)[0]

    def slope(self, theta: np.ndarray) -> np.ndarray:
        """Return the derivative of `radius` with respect to `theta`, 1/rad."""
        return kannala_brandt(theta, self.D)[1]

    def project(self, rays: np.ndarray) -> np.ndarray:
        """Return the image coordinates (N, 2) of rays (N, 3), which may have any direction."""
        rho = np.hypot(rays[:, 0], rays[:, 1])
        r = self.radius(np.arctan2(rho, rays[:, 2]))
        scale = np.divide(r, rho, out=np.zeros_like(r), where=rho > 0)
        return rays[:, :2] * scale[:, None]

    def unproject(self, points: np.ndarray) -> np.ndarray:
        """Return the unit rays (N, 3) of image coordinates (N, 2); NaN beyond the cutoff."""
        r = np.hypot(points[:, 0], points[:, 1])
        limit = float(self.radius(self.cutoff))
        inside = r <= limit
        target = np.where(inside, r, 0.0)
        # Newton's method, bracketed by bisection: CameraConfig has checked that the radius
        # increases with the angle on [0, cutoff].
        low, high = np.zeros_like(r), np.full_like(r, self.cutoff)
        theta = np.clip(target, 0.0, self.cutoff)
        for _ in range(60):
            error = self.radius(theta) - target
            high, low = np.where(error > 0, theta, high), np.where(error > 0, low, theta)
            new = theta - error / np.maximum(self.slope(theta), 1e-9)
            # `theta` is now one end of the bracket [low, high]. A Newton step longer than half the
            # bracket could jump from one end to the other forever, so it is replaced by the middle
            # of the bracket. A step of exactly half the bracket is kept: if both are 0, `theta` is
            # already exact.
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
    """Fit the coefficients of Kannala and Brandt's model to an ideal wide-angle projection.

    `lens` is equidistant, stereographic, equisolid or orthographic. CameraInfo has no name for the
    last three, so images are rendered with the four fitted coefficients, which CameraInfo contains.
    Up to the angle `cutoff` (rad), the error of the image radius is below 1e-4 of the focal length.
    """
    if lens == "equidistant":
        return (0.0, 0.0, 0.0, 0.0)
    # Fit at Chebyshev nodes, because this keeps the largest error of the polynomial small.
    t = cutoff * np.sin(np.linspace(0.0, np.pi / 2, 400)[1:])
    basis = np.stack([t**3, t**5, t**7, t**9], axis=1)
    fit, *_ = np.linalg.lstsq(basis, RADIUS_FUNCTION[lens](t) - t, rcond=None)
    return tuple(float(k) for k in fit)


def check_fisheye(lens: FisheyeLens, name: str) -> None:
    """Raise CameraError if the image radius stops increasing before the cutoff angle.

    `name` is the camera's name, for the message.
    """
    theta = np.linspace(0.0, lens.cutoff, 2000)
    falling = lens.slope(theta) <= 0
    if falling.any():
        at = math.degrees(float(theta[falling.argmax()]))
        raise CameraError(
            f"camera '{name}': with distortion_coefficients {list(lens.D)}, the image radius stops "
            f"increasing at {at:.1f} deg from the axis; lower cutoff_angle below this angle, or "
            "correct the coefficients"
        )
