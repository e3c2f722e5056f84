"""The orientation over a full turn, told from the desired view by the third-order moments.

Second-order moments fix the main axis only up to half a turn. The odd moments change their sign
under a half turn, so the branch is the one in which the third-order moments of the target, turned
by the difference of the angles, agree with those of the desired view.
"""

from __future__ import annotations

from math import cos, pi, sin, sqrt
from typing import TYPE_CHECKING

from .interaction import Plane
from .moments import Moments

if TYPE_CHECKING:
    from .features import Reference


def full_alpha(moments: Moments, alpha: float, reference: Reference, plane: Plane) -> float:
    """alpha or alpha +- pi, in (-pi, pi]."""
    mu = moments.mu
    turned = rotate_third((mu(3, 0), mu(2, 1), mu(1, 2), mu(0, 3)), reference.alpha - alpha)
    if correlation(turned, reference.third) < 0.0:
        alpha += pi if alpha <= 0.0 else -pi
    return alpha


def rotate_third(third: tuple[float, float, float, float], angle: float):
    """mu30, mu21, mu12, mu03 of the shape turned by `angle` (x towards y)."""
    a, b, c, d = third
    k, s = cos(angle), sin(angle)
    return (
        k**3 * a - 3 * k * k * s * b + 3 * k * s * s * c - s**3 * d,
        k * k * s * a + (k**3 - 2 * k * s * s) * b + (s**3 - 2 * k * k * s) * c + k * s * s * d,
        k * s * s * a + (2 * k * k * s - s**3) * b + (k**3 - 2 * k * s * s) * c - k * k * s * d,
        s**3 * a + 3 * k * s * s * b + 3 * k * k * s * c + k**3 * d,
    )


def correlation(a: tuple[float, ...], b: tuple[float, ...]) -> float:
    """Normalised product of two sets of third-order moments, in [-1, 1]; 0 if one vanishes."""

    def product(p, q) -> float:
        return p[0] * q[0] + 3 * p[1] * q[1] + 3 * p[2] * q[2] + p[3] * q[3]

    size = sqrt(product(a, a) * product(b, b))
    return product(a, b) / size if size > 0.0 else 0.0
