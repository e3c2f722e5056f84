"""Orientation of a target in (-pi, pi], relative to that in the desired view.

Second-order moments define the orientation of the main axis, but not its direction: two angles that
differ by half a turn are possible. Third-order moments change their sign under half a turn. The
direction is therefore correct if the third-order moments of the desired view, rotated by the
difference of the two orientations, agree with those of the current view.

A tilt of the target's plane distorts third-order moments, which can reverse the result. This is a
known error of ViSP. Therefore both views are first rectified: the moments that a camera along the
plane's normal would measure are computed from the plane and from the moments of higher order. Only
the choice of the direction depends on rectified moments. The value of alpha is measured in the
image, which is not rectified.
"""

from __future__ import annotations

from math import atan2, cos, pi, sin, sqrt
from typing import NamedTuple

import numpy as np

from aras_visual_servo_base.compiled import jit

from .interaction import Plane
from .moment_sums import translate
from .moments import DENSE, Moments
from .polygons import Array

# A shape is symmetric under half a turn if the norm of its third-order moments, divided by m00
# rg^3, is below this value. Measured norms: up to 2e-3 in images of rectangles, at least 1e-2 for
# shapes with a visible direction.
SYMMETRY_TOLERANCE = 0.003
# Types of the arguments that describe a view: the centred moments; A, B, C of the plane; xg; yg;
# and 3 for a region or 0 for a set of points.
VIEW_SIGNATURE = "f8[:,:], f8, f8, f8, f8, f8, f8"


class TargetOrientation(NamedTuple):
    """Orientation of a target in one view.

    The rectified view is that of a camera along the normal of the target's plane.

    Attributes:
        alpha: orientation of the main axis in the image, in (-pi/2, pi/2].
        upright_alpha: orientation of the main axis in the rectified view, in (-pi/2, pi/2].
        third: mu30, mu21, mu12, mu03 of the rectified view, divided by m00 rg^3, where rg is the
            radius of gyration.
    """

    alpha: float
    upright_alpha: float
    third: tuple[float, float, float, float]

    @classmethod
    def from_moments(cls, moments: Moments, plane: Plane) -> TargetOrientation | None:
        """Return the orientation in one view; return None if it is undefined.

        It is undefined if the shape has no main axis, or if the order of the moments is below 3.
        """
        known, *found = _compute_orientation(*_pack_view(moments, plane))
        return cls(*found) if known else None

    @property
    def is_symmetric(self) -> bool:
        """True if half a turn does not change the shape, up to SYMMETRY_TOLERANCE."""
        return sqrt(compute_third_product(self.third, self.third)) < SYMMETRY_TOLERANCE


def full_alpha(moments: Moments, alpha: float, plane: Plane, reference: TargetOrientation) -> float:
    """Return the orientation of a view in (-pi, pi], relative to that of the desired view.

    Args:
        moments: moments of the view.
        alpha: orientation of the main axis of the view, rad.
        plane: the target's plane in the view.
        reference: orientation in the desired view.

    Returns:
        alpha, or alpha +- pi. For a shape that half a turn does not change, the result is alpha.
    """
    if not _is_opposite(*_pack_view(moments, plane), alpha, *reference):
        return alpha
    return alpha + (pi if alpha <= 0.0 else -pi)


def _pack_view(moments: Moments, plane: Plane) -> tuple[Array | float, ...]:
    """Return the arguments of compiled functions that describe a view; see VIEW_SIGNATURE."""
    shrinking = 3.0 if moments.kind == DENSE else 0.0
    return moments.centred, *plane, moments.xg, moments.yg, shrinking


@jit("UniTuple(f8, 4), f8")
def rotate_third(third, angle):
    """Compute the third-order moments of a shape that is rotated by `angle`, rad, from x to y.

    third: mu30, mu21, mu12, mu03 of the shape. The result has the same order.
    """
    a, b, c, d = third
    # If the shape rotates by the angle a, the complex moment mu30 + mu12 + i (mu21 + mu03) is
    # multiplied by exp(i a), and mu30 - 3 mu12 + i (3 mu21 - mu03) by exp(3 i a).
    once = complex(a + c, b + d) * complex(cos(angle), sin(angle))
    thrice = complex(a - 3 * c, 3 * b - d) * complex(cos(3 * angle), sin(3 * angle))
    m30, m12 = (3 * once.real + thrice.real) / 4, (once.real - thrice.real) / 4
    m03, m21 = (3 * once.imag - thrice.imag) / 4, (once.imag + thrice.imag) / 4
    return m30, m21, m12, m03


@jit("UniTuple(f8, 4), UniTuple(f8, 4)")
def compute_third_product(p, q):
    """Compute a scalar product of the third-order moments of two shapes.

    It does not change if both shapes are rotated by the same angle.

    p, q: mu30, mu21, mu12, mu03 of the two shapes.
    """
    return p[0] * q[0] + 3 * p[1] * q[1] + 3 * p[2] * q[2] + p[3] * q[3]


@jit("f8, f8, f8, f8, f8, f8, f8")
def _compute_plane_map(A, B, C, xg, yg, ex, ey):
    """Compute the matrix G (2, 2) that maps offsets in the image to offsets in the target's plane.

    The axes in the target's plane result from those of the image by the smallest rotation that
    makes the image plane parallel to the target's plane.

    Args:
        A, B, C: the target's plane, 1/Z = A x + B y + C.
        xg, yg: centre of gravity, normalised.
        ex, ey: A and B, divided by the inverse depth at the centre of gravity.
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
    """Compute the moments of the target in its plane, up to order 3.

    The moments are about the point of the plane whose image is the centre of gravity (xg, yg). The
    arguments are those of `compute_upright_moments`, whose docstring defines e, d and G.

    Returns:
        (4, 4). Entry [i, j] is the integral of x^i y^j / (1 + e.d)^(i + j + shrinking) over the
        image of the target, where (x, y) = G d.
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
        # `projected[b]` is the integral of x^(order-b) y^b / (1 + e.d)^(order + shrinking), with e
        # = (ex, ey) and d = (x, y); `shrinking` is 3 for a region and 0 for points.
        projected = np.zeros(order + 1)
        for b in range(order + 1):
            # Coefficient of t^r in the power series of (1 + t)^-k, which is (-1)^r C(k+r-1, r).
            # Here t = ex x + ey y.
            binomial = 1.0
            for r in range(known - order + 1):
                choice = 1.0  # binomial coefficient C(r, y) in the expansion of (ex x + ey y)^r
                for y in range(r + 1):
                    moment = centred[order - b + r - y, b + y]
                    projected[b] += binomial * choice * of_x_tilt[r - y] * of_y_tilt[y] * moment
                    choice *= (r - y) / (y + 1.0)
                binomial *= -(k + r) / (r + 1.0)
        for of_x in range(order + 1):
            # Coefficients of the polynomial (gx.d)^of_x (gy.d)^(order - of_x) in d = (x, y), by
            # increasing powers of y. gx and gy are the rows of G.
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
    """Compute the centred moments up to order 3 that a camera along the plane's normal measures.

    Let d be the offset of an image point from the centre of gravity, Zg the depth there, and
    e = Zg (A, B). In the plane, this offset is G d / (1 + e.d), with the matrix G of
    `_compute_plane_map`; the element of a region's area is divided by (1 + e.d)^3. The powers of
    1 + e.d are expanded up to the order of the given moments. The relative error is about
    (rg |e|)^(order - 2), where rg is the radius of gyration.

    Args:
        centred: (order+1, order+1) centred moments, mu_ij at [i, j].
        A, B, C: the target's plane, 1/Z = A x + B y + C.
        xg, yg: centre of gravity, normalised.
        shrinking: 3 for a region, 0 for a set of points.

    Returns:
        (4, 4) mu_ij at [i, j]. They have an unknown scale: all moments of one order i + j are
        multiplied by the same unknown factor.
    """
    table = _compute_plane_moments(centred, A, B, C, xg, yg, shrinking)
    return translate(table, -table[1, 0] / table[0, 0], -table[0, 1] / table[0, 0])


@jit(VIEW_SIGNATURE)
def _compute_orientation(centred, A, B, C, xg, yg, shrinking):
    """Compute the fields of Orientation, with a flag that is False if they are undefined.

    The arguments are those of `compute_upright_moments`.

    Returns:
        True and the fields; or False and zeros.
    """
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
    """Return whether the orientation of a view is alpha + pi, relative to the desired view.

    The first seven arguments are those of `compute_upright_moments`.

    Args:
        alpha: orientation of the main axis of the view, rad.
        of_alpha, of_upright_alpha, of_third: fields of Orientation for the desired view.
    """
    if np.sqrt(compute_third_product(of_third, of_third)) < SYMMETRY_TOLERANCE:
        return False
    known, _, upright_alpha, third = _compute_orientation(centred, A, B, C, xg, yg, shrinking)
    if not known or np.sqrt(compute_third_product(third, third)) < SYMMETRY_TOLERANCE:
        return False
    turn = upright_alpha - of_upright_alpha
    if compute_third_product(rotate_third(of_third, turn), third) < 0.0:
        turn += pi
    difference = alpha - of_alpha - turn
    return abs(difference - 2.0 * pi * np.rint(difference / (2.0 * pi))) > 0.5 * pi
