"""Orientation of a target over a full turn, with the third-order moments of the desired view.

Second-order moments define the main axis up to half a turn. Odd moments change their sign under a
half turn. The right angle is therefore the one for which the target's third-order moments, rotated
back by the difference of the angles, agree with those of the desired view.

A tilt of the plane distorts third-order moments enough to reverse this result, which is a known
error of ViSP. Therefore both views are first rectified: if the plane is known, the moments that a
camera along its normal would measure follow from the image's moments of higher order. The
rectified moments are used only for the sign; the value of alpha is that of the image.
"""

from __future__ import annotations

from math import atan2, cos, pi, sin, sqrt
from typing import NamedTuple

import numpy as np

from aras_visual_servo_base.compiled import jit

from .interaction import Plane
from .moments import DENSE, Moments, translate
from .polygons import Array

# |mu3| / (m00 rg^3) below which a shape counts as symmetric. Pixels and the truncated expansion
# give up to 2e-3 for a rectangle; shapes with a visible direction have 1e-2 and more.
SYMMETRY_TOLERANCE = 0.003
# Types of a view: centred moments; A, B, C of the plane; xg, yg; 3 for a region or 0 for points.
VIEW_SIGNATURE = "f8[:,:], f8, f8, f8, f8, f8, f8"


class Orientation(NamedTuple):
    """Orientation of one view, as `full_alpha` compares it.

    Attributes:
        alpha: symmetric orientation in the image, rad.
        upright_alpha: symmetric orientation in the rectified view, rad.
        third: mu30, mu21, mu12, mu03 of the rectified view, divided by m00 rg^3.
    """

    alpha: float
    upright_alpha: float
    third: tuple[float, float, float, float]

    @classmethod
    def from_moments(cls, moments: Moments, plane: Plane) -> Orientation | None:
        """Return the orientation of one view, or None if it is undefined.

        It needs a main axis and moments of third order.
        """
        known, *found = _compute_orientation(*_pack_view(moments, plane))
        return cls(*found) if known else None

    @property
    def is_symmetric(self) -> bool:
        """True if a half turn changes the shape by less than the tolerance."""
        return sqrt(compute_third_product(self.third, self.third)) < SYMMETRY_TOLERANCE


def full_alpha(moments: Moments, alpha: float, plane: Plane, reference: Orientation) -> float:
    """Return alpha or alpha +- pi, in (-pi, pi]; for a symmetric shape alpha itself."""
    if reference.is_symmetric or not _is_opposite(*_pack_view(moments, plane), alpha, *reference):
        return alpha
    return alpha + (pi if alpha <= 0.0 else -pi)


def _pack_view(moments: Moments, plane: Plane) -> tuple[Array | float, ...]:
    """Return the arguments of a view for the compiled functions."""
    shrinking = 3.0 if moments.kind == DENSE else 0.0
    return moments.centred, *plane, moments.xg, moments.yg, shrinking


@jit("UniTuple(f8, 4), f8")
def rotate_third(third, angle):
    """Compute mu30, mu21, mu12, mu03 of a shape rotated by `angle` (from x to y), rad."""
    a, b, c, d = third
    # The complex moments mu30 + mu12 + i (mu21 + mu03) and mu30 - 3 mu12 + i (3 mu21 - mu03)
    # rotate by the angle and by three times the angle.
    once = complex(a + c, b + d) * complex(cos(angle), sin(angle))
    thrice = complex(a - 3 * c, 3 * b - d) * complex(cos(3 * angle), sin(3 * angle))
    m30, m12 = (3 * once.real + thrice.real) / 4, (once.real - thrice.real) / 4
    m03, m21 = (3 * once.imag - thrice.imag) / 4, (once.imag + thrice.imag) / 4
    return m30, m21, m12, m03


@jit("UniTuple(f8, 4), UniTuple(f8, 4)")
def compute_third_product(p, q):
    """Compute a scalar product of third-order moments that is invariant to a common rotation."""
    return p[0] * q[0] + 3 * p[1] * q[1] + 3 * p[2] * q[2] + p[3] * q[3]


@jit("f8, f8, f8, f8, f8, f8, f8")
def _compute_plane_map(A, B, C, xg, yg, ex, ey):
    """Compute G (2, 2), which maps image offsets to offsets along two axes of the plane.

    The axes are those of the image, rotated into the plane by the smallest rotation.
    """
    size = np.sqrt(A**2 + B**2 + C**2)
    if C < 0.0:
        size = -size
    a, b, c = A / size, B / size, C / size
    turn = np.array([[1.0 - a * a / (1.0 + c), -a * b / (1.0 + c), -a],
                     [-a * b / (1.0 + c), 1.0 - b * b / (1.0 + c), -b]])
    offset = np.array([[1.0 - xg * ex, -xg * ey], [-yg * ex, 1.0 - yg * ey], [-ex, -ey]])
    G = np.zeros((2, 2))
    for i in range(2):
        for j in range(2):
            for k in range(3):
                G[i, j] += turn[i, k] * offset[k, j]
    return G


@jit(VIEW_SIGNATURE)
def _compute_plane_moments(centred, A, B, C, xg, yg, shrinking):
    """Compute moments (4, 4) of the plane about its point at the image's centre of gravity.

    Entry [i, j] is the integral of (G d)^(i, j) / (1 + e.d)^k, with k = i + j + shrinking and the
    symbols of `compute_upright_moments`.
    """
    inverse_depth = A * xg + B * yg + C
    ex, ey = A / inverse_depth, B / inverse_depth
    G = _compute_plane_map(A, B, C, xg, yg, ex, ey)
    gx, gy = G[0], G[1]
    known, result = centred.shape[0] - 1, np.zeros((4, 4))
    of_x_tilt, of_y_tilt = np.ones(known + 1), np.ones(known + 1)
    for r in range(known):
        of_x_tilt[r + 1], of_y_tilt[r + 1] = of_x_tilt[r] * ex, of_y_tilt[r] * ey
    for order in range(min(3, known) + 1):
        k = order + shrinking
        # projected[b]: integral of x^(order-b) y^b / (1 + e.d)^k
        projected = np.zeros(order + 1)
        for b in range(order + 1):
            # Coefficient of t^r in (1 + t)^-k, i.e. (-1)^r C(k+r-1, r), with t = ex x + ey y.
            binomial = 1.0
            for r in range(known - order + 1):
                choice = 1.0  # binomial coefficient C(r, y)
                for y in range(r + 1):
                    moment = centred[order - b + r - y, b + y]
                    projected[b] += binomial * choice * of_x_tilt[r - y] * of_y_tilt[y] * moment
                    choice *= (r - y) / (y + 1.0)
                binomial *= -(k + r) / (r + 1.0)
        for of_x in range(order + 1):
            # Coefficients of (gx.d)^of_x (gy.d)^(order - of_x) by increasing power of y.
            form = np.zeros(order + 1)
            form[0] = 1.0
            for step in range(order):
                g = gx if step < of_x else gy
                for b in range(step + 1, 0, -1):
                    form[b] = g[0] * form[b] + g[1] * form[b - 1]
                form[0] *= g[0]
            result[of_x, order - of_x] = (form * projected).sum()
    return result


@jit(VIEW_SIGNATURE)
def compute_upright_moments(centred, A, B, C, xg, yg, shrinking):
    """Compute the centred moments up to order 3 of a camera that looks along the plane's normal.

    Let d be the offset from the centre of gravity g in the image, e = (A, B) / (1/Zg), and G the
    linear map from d to offsets in the plane. A point of the plane is at G d / (1 + e.d), and an
    area element of a region shrinks by (1 + e.d)^3. The powers of (1 + e.d) are expanded up to the
    order of the known moments. The remainder is of the order of (rg |e|)^(order - 2), which is
    small for a target that is small compared with its distance.

    Args:
        centred: central moments mu_ij at [i, j].
        A, B, C: the plane, 1/Z = A x + B y + C.
        xg, yg: centre of gravity, normalised.
        shrinking: 3 for a region, 0 for points.

    Returns:
        (4, 4), mu_ij at [i, j], up to a common factor per order.
    """
    table = _compute_plane_moments(centred, A, B, C, xg, yg, shrinking)
    return translate(table, -table[1, 0] / table[0, 0], -table[0, 1] / table[0, 0])


@jit(VIEW_SIGNATURE)
def _compute_orientation(centred, A, B, C, xg, yg, shrinking):
    """Return True and the fields of Orientation, or False and zeros if it is undefined."""
    undefined = False, 0.0, 0.0, (0.0, 0.0, 0.0, 0.0)
    if len(centred) < 4:
        return undefined
    mu = compute_upright_moments(centred, A, B, C, xg, yg, shrinking)
    m00, total = mu[0, 0], mu[2, 0] + mu[0, 2]
    c, s = centred[2, 0] - centred[0, 2], 2.0 * centred[1, 1]
    upright_c, upright_s = mu[2, 0] - mu[0, 2], 2.0 * mu[1, 1]
    if (c == s == 0.0) or (upright_c == upright_s == 0.0) or not (total > 0.0 and m00 > 0.0):
        return undefined
    scale = m00 * (total / m00) ** 1.5
    third = mu[3, 0] / scale, mu[2, 1] / scale, mu[1, 2] / scale, mu[0, 3] / scale
    return True, 0.5 * atan2(s, c), 0.5 * atan2(upright_s, upright_c), third


@jit(f"{VIEW_SIGNATURE}, f8, f8, f8, UniTuple(f8, 4)")
def _is_opposite(centred, A, B, C, xg, yg, shrinking, alpha, of_alpha, of_upright_alpha, of_third):
    """Check whether a view points in the direction opposite to `alpha` (rad) in its image.

    of_alpha, of_upright_alpha, of_third: fields of the reference's Orientation.
    """
    known, _, upright_alpha, third = _compute_orientation(centred, A, B, C, xg, yg, shrinking)
    if not known or np.sqrt(compute_third_product(third, third)) < SYMMETRY_TOLERANCE:
        return False
    turn = upright_alpha - of_upright_alpha
    if compute_third_product(rotate_third(of_third, turn), third) < 0.0:
        turn += pi
    difference = alpha - of_alpha - turn
    return abs(difference - 2.0 * pi * np.rint(difference / (2.0 * pi))) > 0.5 * pi
