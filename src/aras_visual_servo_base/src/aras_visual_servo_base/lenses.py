"""Lens models in normalised coordinates, with OpenCV's coefficients in OpenCV's order."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence

import numpy as np

from .compiled import jit, jit_inline

ITERATIONS = 30
# Errors of the distorted coordinates, normalised: Newton's method stops below GOAL_ERROR, and its
# result is valid below VALID_ERROR.
GOAL_ERROR, VALID_ERROR = 1e-14, 1e-10


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


# The compiled loops of Brown's model get all 14 coefficients `D`, of which those that a camera does
# not have are zero, and the homography `tilt` (3, 3) of a tilted sensor, used if `is_tilted`.
@jit_inline
def _distort_point(x, y, D, tilt, is_tilted):
    """Return the distorted x and y of a point, and a, b, c, d of the Jacobian [[a, b], [c, d]]."""
    p1, p2 = D[2], D[3]
    r2 = x * x + y * y
    top = 1.0 + r2 * (D[0] + r2 * (D[1] + r2 * D[4]))
    low = 1.0 + r2 * (D[5] + r2 * (D[6] + r2 * D[7]))
    radial = top / low
    dtop = D[0] + r2 * (2.0 * D[1] + 3.0 * D[4] * r2)
    dlow = D[5] + r2 * (2.0 * D[6] + 3.0 * D[7] * r2)
    slope = (dtop - radial * dlow) / low  # d(radial)/d(r2)
    xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    a = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    b = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    d = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    # Thin prism.
    xd, yd = xd + r2 * (D[8] + D[9] * r2), yd + r2 * (D[10] + D[11] * r2)
    of_x, of_y = 2.0 * (D[8] + 2.0 * D[9] * r2), 2.0 * (D[10] + 2.0 * D[11] * r2)
    a, b, c, d = a + of_x * x, b + of_x * y, b + of_y * x, d + of_y * y
    if not is_tilted:
        return xd, yd, a, b, c, d
    u = tilt[0, 0] * xd + tilt[0, 1] * yd + tilt[0, 2]
    v = tilt[1, 0] * xd + tilt[1, 1] * yd + tilt[1, 2]
    w = tilt[2, 0] * xd + tilt[2, 1] * yd + tilt[2, 2]
    xt, yt = u / w, v / w
    # Chain rule: the Jacobian of the tilt times the Jacobian of the previous steps.
    e, f = (tilt[0, 0] - xt * tilt[2, 0]) / w, (tilt[0, 1] - xt * tilt[2, 1]) / w
    g, h = (tilt[1, 0] - yt * tilt[2, 0]) / w, (tilt[1, 1] - yt * tilt[2, 1]) / w
    return xt, yt, e * a + f * c, e * b + f * d, g * a + h * c, g * b + h * d


@jit("f8[:], f8[:], f8[:], f8[:,:], b1, f8[:,::1]", allocates=False)
def distort_points(x, y, D, tilt, is_tilted, out):
    """Distort n points; write x, y and a, b, c, d of the Jacobian to `out` (6, n)."""
    for n in range(len(x)):
        xd, yd, a, b, c, d = _distort_point(x[n], y[n], D, tilt, is_tilted)
        out[0, n], out[1, n] = xd, yd
        out[2, n], out[3, n], out[4, n], out[5, n] = a, b, c, d


@jit("f8[:], f8[:], f8[:], f8[:,:], b1, f8, f8[:,::1], b1[::1]", allocates=False)
def undistort_points(xd, yd, D, tilt, is_tilted, largest_radius, out, valid):
    """Invert the distortion of n points by Newton's method.

    The distorted radius increases with the undistorted radius only up to a certain radius. A root
    beyond this radius is wrong. A wrong root is recognised because its undistorted radius is above
    `largest_radius`, or because the determinant or the trace of the Jacobian is not positive.

    Args:
        xd, yd: (n,) distorted coordinates, normalised.
        largest_radius: roots beyond this undistorted radius are rejected.
        out: (2, n) array to which x and y are written, 0 for points that are not valid.
        valid: (n,) array to which the validity of each point is written. A point is valid if the
            iteration converges to a root that is not rejected.
    """
    for n in range(len(xd)):
        x, y = xd[n], yd[n]
        px, py, a, b, c, d = _distort_point(x, y, D, tilt, is_tilted)
        for _ in range(ITERATIONS):
            ex, ey = px - xd[n], py - yd[n]
            if abs(ex) + abs(ey) < GOAL_ERROR:
                break
            determinant = a * d - b * c
            x, y = x - (d * ex - b * ey) / determinant, y - (a * ey - c * ex) / determinant
            px, py, a, b, c, d = _distort_point(x, y, D, tilt, is_tilted)
        valid[n] = (
            abs(px - xd[n]) + abs(py - yd[n]) < VALID_ERROR
            and a * d - b * c > 0.0
            and a + d > 0.0
            and x * x + y * y < largest_radius * largest_radius
        )
        out[0, n] = x if valid[n] else 0.0
        out[1, n] = y if valid[n] else 0.0
