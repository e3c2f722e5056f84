"""Checks of features that are undefined if their denominator vanishes.

All checks are dimensionless: a moment of order n is compared with m00 rg^n, where rg is the radius
of gyration. The result therefore does not depend on the size or distance of the target.
"""

from __future__ import annotations

from collections.abc import Callable
from math import comb, sqrt

from .moments import Moments

# Rounding errors are about 1e-13. If a denominator is below this tolerance, too few digits of the
# feature are correct.
DEFAULT_TOLERANCE = 1e-9


def gyration_radius(moments: Moments) -> float:
    """Compute the radius of gyration sqrt((mu20 + mu02) / m00) in normalised units."""
    mu20, _, mu02 = moments.second
    return sqrt(max(mu20 + mu02, 0.0) / moments.m00)


def moment_norm(moments: Moments, n: int) -> float:
    """Compute a norm of the centred moments of order n that does not change if the image rotates.
    """
    return sqrt(sum(comb(n, j) * moments.mu(n - j, j) ** 2 for j in range(n + 1)))


def asymmetry(moments: Moments, n: int = 3) -> float:
    """Compute the norm of the centred moments of order n, divided by m00 rg^n.

    rg is the radius of gyration. For odd n, the result is zero if the shape has a centre of
    symmetry.
    """
    scale = moments.m00 * gyration_radius(moments) ** n
    return moment_norm(moments, n) / scale if scale > 0.0 else 0.0


def anisotropy(moments: Moments) -> float:
    """Compute sqrt((mu20 - mu02)^2 + 4 mu11^2) / (mu20 + mu02).

    It is 0 for a square or a disc and 1 for a line.
    """
    mu20, mu11, mu02 = moments.second
    c, s, total = mu20 - mu02, 2.0 * mu11, mu20 + mu02
    return sqrt(c * c + s * s) / total if total > 0.0 else 0.0


def _check_anisotropy(moments: Moments, value: float, tolerance: float) -> str | None:
    if anisotropy(moments) > tolerance:
        return None
    return (
        "the shape has no main axis: mu20 = mu02 and mu11 = 0, as for a square parallel to the "
        "image plane"
    )


def _make_ratio_check(
    n: int, degree: int, name: str
) -> Callable[[Moments, float, float], str | None]:
    def check(moments: Moments, value: float, tolerance: float) -> str | None:
        if n % 2 and asymmetry(moments, n) <= tolerance:
            return f"the shape is symmetric about its centre: its moments of order {n} vanish"
        if abs(value) ** (1.0 / degree) <= tolerance ** (1.0 / degree) * moment_norm(moments, n):
            return f"its denominator {name} vanishes for this shape"
        return None

    return check


# Check of each denominator: a function of the moments, the value of the denominator and the
# tolerance. It returns the reason why the feature is undefined, or None if it is defined.
CHECKS: dict[str, Callable[[Moments, float, float], str | None]] = {
    "anisotropy": _check_anisotropy,
    "I4": _make_ratio_check(3, 2, "I4"),
    "I6": _make_ratio_check(3, 4, "I6"),
    "I10": _make_ratio_check(4, 2, "I10"),
    "I15": _make_ratio_check(5, 2, "I15"),
}
