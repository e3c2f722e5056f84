"""Formulas of lenses at unit focal length, with OpenCV's coefficients in OpenCV's order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def brown(x: np.ndarray, y: np.ndarray, D: Sequence[float]) -> tuple[np.ndarray, ...]:
    """Distorted x and y (n,) by Brown's model with a rational radial part, and their Jacobian.

    D: k1 k2 p1 p2 k3 k4 k5 k6, or the first of them.

    Returns:
        x, y, and the entries a, b, d of the symmetric Jacobian [[a, b], [b, d]], each (n,).
    """
    k1, k2, p1, p2, k3, k4, k5, k6 = (*D, *(0.0,) * (8 - len(D)))
    r2 = x * x + y * y
    top = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    low = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = top / low
    dtop = k1 + r2 * (2.0 * k2 + 3.0 * k3 * r2)
    dlow = k4 + r2 * (2.0 * k5 + 3.0 * k6 * r2)
    slope = (dtop - radial * dlow) / low  # d(radial)/d(r2)
    xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    a = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    b = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    d = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    return xd, yd, a, b, d


def kannala_brandt(theta: np.ndarray, D: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Distances (n,) from the image's centre of angles (n,) from the axis, rad, and their slope.

    D: k1 k2 k3 k4 of theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8).
    """
    k1, k2, k3, k4 = D
    t2 = np.square(theta)
    radius = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
    return radius, 1.0 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))
