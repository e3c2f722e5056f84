"""The orientation over a full turn, told from the desired view by the third-order moments.

Second-order moments fix the main axis only up to half a turn. Odd moments change their sign under
a half turn, so the right branch is the one in which the third-order moments of the target, turned
back by the difference of the angles, agree with those of the desired view.

A tilt of the plane distorts third-order moments enough to turn that answer round (ViSP errs here,
and so does any test on the moments as they are). So both views are first turned square on: where
the plane is known, the moments that a camera along its normal would see follow from the image's
moments of higher order. That has to be right in the sign only; the value of alpha stays that of
the image itself.
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
# leave up to 2e-3 of a rectangle; shapes that have a direction to the eye have 1e-2 and more.
SYMMETRY_TOLERANCE = 0.003
# Of a view: its centred moments, A, B, C of its plane, xg, yg, 3 for a region.
VIEW_SIGNATURE = "f8[:,:], f8, f8, f8, f8, f8, f8"


class Orientation(NamedTuple):
    """What full_alpha() compares.

    Attributes:
        alpha: symmetric orientation in the image, rad.
        upright_alpha: the same as seen square on, rad.
        third: mu30, mu21, mu12, mu03 as seen square on, over m00 rg^3.
    """

    alpha: float
    upright_alpha: float
    third: tuple[float, float, float, float]

    @classmethod
    def from_moments(cls, moments: Moments, plane: Plane) -> Orientation | None:
        """Orientation of one view; None without a main axis or without third-order moments."""
        known, *found = _compute_orientation(*_pack_view(moments, plane))
        return cls(*found) if known else None

    @property
    def is_symmetric(self) -> bool:
        """True if a half turn makes no difference that could be told."""
        return sqrt(compute_third_product(self.third, self.third)) < SYMMETRY_TOLERANCE


def full_alpha(moments: Moments, alpha: float, plane: Plane, reference: Orientation) -> float:
    """alpha or alpha +- pi, in (-pi, pi]; alpha itself for a symmetric shape."""
    if reference.is_symmetric or not _is_opposite(*_pack_view(moments, plane), alpha, *reference):
        return alpha
    return alpha + (pi if alpha <= 0.0 else -pi)


def _pack_view(moments: Moments, plane: Plane) -> tuple[Array | float, ...]:
    """What the compiled functions take of one view."""
    shrinking = 3.0 if moments.kind == DENSE else 0.0
    return moments.centred, *plane, moments.xg, moments.yg, shrinking


@jit("UniTuple(f8, 4), f8")
def rotate_third(third, angle):
    """mu30, mu21, mu12, mu03 of a shape turned by `angle` (x towards y), rad."""
    a, b, c, d = third
    # The complex moments mu30 + mu12 + i (mu21 + mu03) and mu30 - 3 mu12 + i (3 mu21 - mu03)
    # turn by once and three times the angle.
    once = complex(a + c, b + d) * complex(cos(angle), sin(angle))
    thrice = complex(a - 3 * c, 3 * b - d) * complex(cos(3 * angle), sin(3 * angle))
    m30, m12 = (3 * once.real + thrice.real) / 4, (once.real - thrice.real) / 4
    m03, m21 = (3 * once.imag - thrice.imag) / 4, (once.imag + thrice.imag) / 4
    return m30, m21, m12, m03


@jit("UniTuple(f8, 4), UniTuple(f8, 4)")
def compute_third_product(p, q):
    """Scalar product of third-order moments that a common rotation leaves alone."""
    return p[0] * q[0] + 3 * p[1] * q[1] + 3 * p[2] * q[2] + p[3] * q[3]


@jit("f8, f8, f8, f8, f8, f8, f8")
def _compute_plane_map(A, B, C, xg, yg, ex, ey):
    """G (2, 2): image offset to offset along two axes of the plane, the shortest turn away from
    the image's axes."""
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
    """(4, 4) moments about the point of the plane (A, B, C) at (0, 0): of
    (G d)^(i, j) / (1 + e.d)^k, with k = i + j + shrinking."""
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
        # seen[b]: integral of x^(order-b) y^b / (1 + e.d)^k
        seen = np.zeros(order + 1)
        for b in range(order + 1):
            binomial = 1.0  # of (1 + t)^-k = sum of (-1)^r C(k+r-1, r) t^r, t = ex x + ey y
            for r in range(known - order + 1):
                choice = 1.0  # C(r, y)
                for y in range(r + 1):
                    moment = centred[order - b + r - y, b + y]
                    seen[b] += binomial * choice * of_x_tilt[r - y] * of_y_tilt[y] * moment
                    choice *= (r - y) / (y + 1.0)
                binomial *= -(k + r) / (r + 1.0)
        for of_x in range(order + 1):
            # (gx.d)^of_x (gy.d)^(order - of_x), by rising power of y
            form = np.zeros(order + 1)
            form[0] = 1.0
            for step in range(order):
                g = gx if step < of_x else gy
                for b in range(step + 1, 0, -1):
                    form[b] = g[0] * form[b] + g[1] * form[b - 1]
                form[0] *= g[0]
            result[of_x, order - of_x] = (form * seen).sum()
    return result


@jit(VIEW_SIGNATURE)
def compute_upright_moments(centred, A, B, C, xg, yg, shrinking):
    """Centred moments up to order 3 as a camera looking along the plane's normal sees them.

    With d the offset from the centre of gravity g in the image, e = (A, B) / (1/Zg) and G the
    linear map from d to offsets in the plane, a point of the plane stands at G d / (1 + e.d), and
    an area element of a region shrinks by (1 + e.d)^3. The powers of (1 + e.d) are expanded as
    far as the order of the known moments goes; what is left out is of the order of
    (rg |e|)^(order - 2), small for a target that is small beside its distance.

    Args:
        centred: central moments mu_ij at [i, j].
        A, B, C: the plane, 1/Z = A x + B y + C.
        xg, yg: centre of gravity, normalised.
        shrinking: 3 for a region, 0 for points.

    Returns:
        (4, 4), up to a common factor per order: mu_ij at [i, j].
    """
    table = _compute_plane_moments(centred, A, B, C, xg, yg, shrinking)
    return translate(table, -table[1, 0] / table[0, 0], -table[0, 1] / table[0, 0])


@jit(VIEW_SIGNATURE)
def _compute_orientation(centred, A, B, C, xg, yg, shrinking):
    """Whether there is one, and what Orientation holds."""
    none = False, 0.0, 0.0, (0.0, 0.0, 0.0, 0.0)
    if len(centred) < 4:
        return none
    mu = compute_upright_moments(centred, A, B, C, xg, yg, shrinking)
    m00, total = mu[0, 0], mu[2, 0] + mu[0, 2]
    c, s = centred[2, 0] - centred[0, 2], 2.0 * centred[1, 1]
    upright_c, upright_s = mu[2, 0] - mu[0, 2], 2.0 * mu[1, 1]
    if (c == s == 0.0) or (upright_c == upright_s == 0.0) or not (total > 0.0 and m00 > 0.0):
        return none
    scale = m00 * (total / m00) ** 1.5
    third = mu[3, 0] / scale, mu[2, 1] / scale, mu[1, 2] / scale, mu[0, 3] / scale
    return True, 0.5 * atan2(s, c), 0.5 * atan2(upright_s, upright_c), third


@jit(f"{VIEW_SIGNATURE}, f8, f8, f8, UniTuple(f8, 4)")
def _is_opposite(centred, A, B, C, xg, yg, shrinking, alpha, of_alpha, of_upright_alpha, of_third):
    """Whether a view with alpha (rad) in its image points the other way than alpha says.

    of_alpha, of_upright_alpha, of_third: the reference's Orientation.
    """
    known, _, upright_alpha, third = _compute_orientation(centred, A, B, C, xg, yg, shrinking)
    if not known or np.sqrt(compute_third_product(third, third)) < SYMMETRY_TOLERANCE:
        return False
    turn = upright_alpha - of_upright_alpha
    if compute_third_product(rotate_third(of_third, turn), third) < 0.0:
        turn += pi
    off = alpha - of_alpha - turn
    return abs(off - 2.0 * pi * np.rint(off / (2.0 * pi))) > 0.5 * pi
