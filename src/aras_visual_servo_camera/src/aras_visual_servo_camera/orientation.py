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

from cmath import exp
from functools import cache
from math import atan2, comb, pi, remainder, sqrt
from operator import mul
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .interaction import Plane
from .moments import DENSE, Array, Moments, exponents, translate

# |mu3| / (m00 rg^3) below which a shape counts as symmetric. Pixels and the truncated expansion
# leave up to 2e-3 of a rectangle; shapes that have a direction to the eye have 1e-2 and more.
SYMMETRY_TOLERANCE = 0.003


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
    def of(cls, moments: Moments, plane: Plane) -> Orientation | None:
        """Orientation of one view; None without a main axis or without third-order moments."""
        if moments.order < 3:
            return None
        mu = upright(moments, plane)
        total, m00 = mu[2, 0] + mu[0, 2], mu[0, 0]
        alpha, upright_alpha = _main_axis(moments.centred), _main_axis(mu)
        if alpha is None or upright_alpha is None or not (total > 0.0 and m00 > 0.0):
            return None
        scale = m00 * (total / m00) ** 1.5
        third = tuple(float(mu[3 - k, k]) / scale for k in range(4))
        return cls(alpha, upright_alpha, third)

    @property
    def symmetric(self) -> bool:
        """True if a half turn makes no difference that could be told."""
        return sqrt(product(self.third, self.third)) < SYMMETRY_TOLERANCE


def full_alpha(moments: Moments, alpha: float, plane: Plane, reference: Orientation) -> float:
    """alpha or alpha +- pi, in (-pi, pi]; alpha itself for a symmetric shape."""
    current = Orientation.of(moments, plane)
    if current is None or current.symmetric or reference.symmetric:
        return alpha
    turn = current.upright_alpha - reference.upright_alpha
    if product(rotate_third(reference.third, turn), current.third) < 0.0:
        turn += pi
    if abs(remainder(alpha - reference.alpha - turn, 2.0 * pi)) > 0.5 * pi:
        alpha += pi if alpha <= 0.0 else -pi
    return alpha


def rotate_third(third: tuple[float, ...], angle: float) -> tuple[float, float, float, float]:
    """mu30, mu21, mu12, mu03 of a shape turned by `angle` (x towards y), rad."""
    a, b, c, d = third
    # The complex moments mu30 + mu12 + i (mu21 + mu03) and mu30 - 3 mu12 + i (3 mu21 - mu03)
    # turn by once and three times the angle.
    once = complex(a + c, b + d) * exp(1j * angle)
    thrice = complex(a - 3 * c, 3 * b - d) * exp(3j * angle)
    m30, m12 = (3 * once.real + thrice.real) / 4, (once.real - thrice.real) / 4
    m03, m21 = (3 * once.imag - thrice.imag) / 4, (once.imag + thrice.imag) / 4
    return m30, m21, m12, m03


def product(p: tuple[float, ...], q: tuple[float, ...]) -> float:
    """Scalar product of third-order moments that a common rotation leaves alone."""
    return p[0] * q[0] + 3 * p[1] * q[1] + 3 * p[2] * q[2] + p[3] * q[3]


def upright(moments: Moments, plane: Plane) -> Array:
    """Centred moments up to order 3 as a camera looking along the plane's normal sees them.

    With d the offset from the centre of gravity g in the image, e = (A, B) / (1/Zg) and G the
    linear map from d to offsets in the plane, a point of the plane stands at G d / (1 + e.d), and
    an area element of a region shrinks by (1 + e.d)^3. The powers of (1 + e.d) are expanded as
    far as the order of the known moments goes; what is left out is of the order of
    (rg |e|)^(order - 2), small for a target that is small beside its distance.

    Returns:
        (4, 4), up to a common factor per order: mu_ij at [i, j].
    """
    inverse_depth = plane.inverse_depth(moments.xg, moments.yg)
    ex, ey = plane.A / inverse_depth, plane.B / inverse_depth
    gx, gy = _in_plane(plane, moments.xg, moments.yg, ex, ey)
    x, y, factors, i, j = _expansion(moments.order, moments.kind == DENSE)
    rising = np.arange(moments.order + 1)
    terms = (float(ex) ** rising)[x] * (float(ey) ** rising)[y]
    # seen[s(s+1)/2 + b]: integral of x^(s-b) y^b / (1 + e.d)^k
    seen = ((factors * moments.centred[i, j]) @ terms).tolist()
    result = np.zeros((4, 4))
    (p, q), (u, v) = gx.tolist(), gy.tolist()
    first = 0
    for order in range(4):
        for of_x in range(order + 1):
            # (p x + q y)^of_x (u x + v y)^(order - of_x), by rising power of y
            form = [1.0]
            for step in range(order):
                a, b = (p, q) if step < of_x else (u, v)
                form = [a * m + b * n for m, n in zip([*form, 0.0], [0.0, *form], strict=True)]
            result[of_x, order - of_x] = sum(map(mul, form, seen[first : first + order + 1]))
        first += order + 1
    m00 = result[0, 0]
    return translate(result, -result[1, 0] / m00, -result[0, 1] / m00)


@cache
def _expansion(order: int, dense: bool) -> tuple[NDArray[np.intp] | Array, ...]:
    """The terms of (1 + e.d)^-k and where their moments stand, for what upright() sums.

    Returns:
        Powers of ex and ey of each term, (t,) each; then (10, t), for x^(s-b) y^b in exchange
        order up to s = 3: each term's factor, 0 where it goes beyond the order that is known, and
        the moment (i, j) that it takes.
    """
    powers, wanted = exponents(order), exponents(min(3, order))
    factors = np.zeros((10, len(powers)))
    i, j = np.zeros((2, 10, len(powers)), int)
    for row, (a, b) in enumerate(wanted):
        k = a + b + (3 if dense else 0)
        for column, (x, y) in enumerate(powers):
            r = x + y
            if a + b + r > order:
                continue
            # (1 + t)^-k = sum of (-1)^r C(k+r-1, r) t^r with t = ex x + ey y
            binomial = comb(k + r - 1, r) if r else 1
            factors[row, column] = (-1) ** r * binomial * comb(r, y)
            i[row, column], j[row, column] = a + x, b + y
    x, y = np.array(powers).T
    return x, y, factors, i, j


def _in_plane(plane: Plane, xg: float, yg: float, ex: float, ey: float) -> tuple[Array, Array]:
    """Rows (2,) of G: image offset to offset along two axes of the plane, the shortest turn away
    from the image's axes."""
    normal = np.array(plane) / sqrt(plane.A**2 + plane.B**2 + plane.C**2)
    if normal[2] < 0.0:
        normal = -normal
    a, b, c = normal
    turn = np.array(
        [[1.0 - a * a / (1.0 + c), -a * b / (1.0 + c), -a],
         [-a * b / (1.0 + c), 1.0 - b * b / (1.0 + c), -b]]
    )  # fmt: skip
    offset = np.array([[1.0 - xg * ex, -xg * ey], [-yg * ex, 1.0 - yg * ey], [-ex, -ey]])
    G = turn @ offset
    return G[0], G[1]


def _main_axis(mu: Array) -> float | None:
    c, s = float(mu[2, 0] - mu[0, 2]), 2.0 * float(mu[1, 1])
    return None if c == 0.0 and s == 0.0 else 0.5 * atan2(s, c)
