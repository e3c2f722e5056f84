"""Lens models in normalised coordinates, with OpenCV's coefficients in OpenCV's order."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence

import numpy as np

from .brown_distortion import distort_points, undistort_points


def brown(x: np.ndarray, y: np.ndarray, D: Sequence[float]) -> tuple[np.ndarray, ...]:
    """Distort points by Brown's model with rational radial terms, and compute the Jacobian.

    The formulas are those of OpenCV (calib3d, "Detailed description").

    Args:
        x, y: undistorted normalised coordinates, of equal shape, such as (n,).
        D: up to 14 coefficients: k1 k2 p1 p2 k3 k4 k5 k6, the thin prism coefficients s1 s2 s3 s4,
            and the tilt of the sensor taux tauy (rad). Coefficients omitted at the end are zero.

    Returns:
        Distorted x and y; and a, b, c, d of the Jacobian [[a, b], [c, d]] of the distorted
        coordinates with respect to the undistorted ones. Each has the shape of x.
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    out = np.empty((6, x.size))
    distort_points(x.ravel(), y.ravel(), *_fill_coefficients(tuple(D)), out)
    return tuple(out.reshape(6, *x.shape))


def undistort_brown(
    xd: np.ndarray, yd: np.ndarray, D: Sequence[float], largest_radius: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Invert `brown` for the distorted coordinates xd, yd (n,).

    Returns:
        Undistorted x and y (n,); and for each point whether it is valid (n,). A point is not valid
        if the iteration does not converge, or if its undistorted radius is above `largest_radius`
        or above the result of `fold_radius`. Its x and y are then 0.
    """
    xd, yd = np.asarray(xd, dtype=float), np.asarray(yd, dtype=float)
    out, valid = np.empty((2, xd.size)), np.empty(xd.size, np.bool_)
    radius = min(largest_radius, fold_radius(tuple(D)))
    undistort_points(
        xd.ravel(), yd.ravel(), *_fill_coefficients(tuple(D)), radius, out, valid
    )
    x, y = out.reshape(2, *xd.shape)
    return x, y, valid.reshape(xd.shape)


@functools.lru_cache(maxsize=32)
def _fill_coefficients(D: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray, bool]:
    """Return all 14 coefficients, the homography (3, 3) of the tilt, and whether there is a tilt.
    """
    coefficients = np.array((*D, *(0.0,) * (14 - len(D))))
    taux, tauy = coefficients[12:].tolist()
    return coefficients, _tilt_homography(taux, tauy), bool(taux or tauy)


def _tilt_homography(taux: float, tauy: float) -> np.ndarray:
    """Return the homography (3, 3) of a sensor that is tilted about x, then about y.

    The angles are in rad and have OpenCV's signs.
    """
    cx, sx, cy, sy = math.cos(taux), math.sin(taux), math.cos(tauy), math.sin(tauy)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, sx], [0.0, -sx, cx]])
    about_y = np.array([[cy, 0.0, -sy], [0.0, 1.0, 0.0], [sy, 0.0, cy]])
    R = about_y @ about_x
    onto_z = np.array([[R[2, 2], 0.0, -R[0, 2]], [0.0, R[2, 2], -R[1, 2]], [0.0, 0.0, 1.0]])
    return onto_z @ R


@functools.lru_cache(maxsize=32)
def fold_radius(D: tuple[float, ...]) -> float:
    """Return the undistorted radius at which the distorted radius of `brown` has its maximum.

    Only the radial coefficients are considered. Return infinity if there is no maximum.
    """
    k1, k2, _, _, k3, k4, k5, k6 = (*D, *(0.0,) * (8 - len(D)))[:8]
    one = np.polynomial.Polynomial([1.0])
    s = np.polynomial.Polynomial([0.0, 1.0])  # r squared
    n, d = one + k1 * s + k2 * s**2 + k3 * s**3, one + k4 * s + k5 * s**2 + k6 * s**3
    # With s = r^2, the distorted radius r n(s) / d(s) has its maximum where n d + 2 s (n' d - n d')
    # = 0.
    slope = n * d + 2.0 * s * (n.deriv() * d - n * d.deriv())
    roots = np.concatenate([slope.roots(), d.roots() if d.degree() else []])
    real = roots[(np.abs(roots.imag) < 1e-9) & (roots.real > 1e-12)].real
    return float(np.sqrt(real.min())) if len(real) else math.inf


def extrapolate_brown(
    x: np.ndarray, y: np.ndarray, D: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Distort x and y (n,) with `brown`, and extrapolate linearly beyond a certain radius.

    Beyond this radius, which `fold_radius` returns, the polynomial would map points outside of the
    field of view into the image.
    """
    fold = fold_radius(D)
    if math.isinf(fold):
        return brown(x, y, D)[:2]
    factor = np.maximum(np.hypot(x, y) / fold, 1.0)
    xd, yd = brown(x / factor, y / factor, D)[:2]
    return factor * xd, factor * yd


def kannala_brandt(theta: np.ndarray, D: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return the radius (n,) in the image for angles (n,) to the optical axis, and its slope.

    The radius is theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8), with theta in rad
    and D = (k1, k2, k3, k4). The slope (n,) is its derivative with respect to theta.
    """
    k1, k2, k3, k4 = D
    t2 = np.square(theta)
    radius = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
    return radius, 1.0 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))


def extrapolate_kannala_brandt(theta: np.ndarray, D: Sequence[float]) -> np.ndarray:
    """Return the radius (n,) of `kannala_brandt`, extrapolated linearly beyond its maximum."""
    factor = np.maximum(theta / kannala_brandt_fold(D), 1.0)
    return factor * kannala_brandt(theta / factor, D)[0]


def kannala_brandt_fold(D: Sequence[float]) -> float:
    """Return the angle (rad) at which the radius of `kannala_brandt` has its maximum.

    Return infinity if the radius increases monotonically.
    """
    k1, k2, k3, k4 = D
    roots = np.polynomial.Polynomial([1.0, 3 * k1, 5 * k2, 7 * k3, 9 * k4]).trim().roots()
    real = roots[(np.abs(roots.imag) < 1e-9) & (roots.real > 1e-12)].real
    return float(np.sqrt(real.min())) if len(real) else math.inf
