"""Checks whether a feature is undefined, because the denominator of its formula vanishes.

All checks are dimensionless: a moment of order n is compared with m00 rg^n, where rg is the radius
of gyration. The result therefore does not depend on the size or distance of the target.
"""

from __future__ import annotations

from collections.abc import Callable
from math import comb, sqrt

from .moments import Moments

# A feature is undefined if the dimensionless denominator of its formula is below this value. The
# denominator has rounding errors of about 1e-13, so a feature near this limit has about four
# correct digits.
DEFAULT_TOLERANCE = 1e-9


def gyration_radius(moments: Moments) -> float:
    """Compute the radius of gyration sqrt((mu20 + mu02) / m00) in normalised units."""
    mu20, _, mu02 = moments.second
    return sqrt(max(mu20 + mu02, 0.0) / moments.m00)


def moment_norm(moments: Moments, n: int) -> float:
    """Compute sqrt(sum over j of C(n, j) mu_{n-j,j}^2), a norm of the centred moments of order n.

    C is the binomial coefficient. The norm does not change if the image rotates.
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
        "the shape has no main axis, because mu20 = mu02 and mu11 = 0, as for a square parallel "
        "to the image plane; use an elongated target or another feature"
    )


def _make_ratio_check(
    n: int, degree: int, name: str
) -> Callable[[Moments, float, float], str | None]:
    def check(moments: Moments, value: float, tolerance: float) -> str | None:
        if n % 2 and asymmetry(moments, n) <= tolerance:
            return (
                f"the shape is symmetric about its centre: its moments of order {n} vanish; use an "
                "asymmetric target or another feature"
            )
        if abs(value) ** (1.0 / degree) <= tolerance ** (1.0 / degree) * moment_norm(moments, n):
            return (
                f"the feature's denominator {name} vanishes for this shape; use another target or "
                "another feature"
            )
        return None

    return check


# For each denominator, the function that checks it. Its arguments are the moments, the value of the
# denominator and the tolerance. It returns the reason why a feature with this denominator is
# undefined, or None if the feature is defined.
CHECKS: dict[str, Callable[[Moments, float, float], str | None]] = {
    "anisotropy": _check_anisotropy,
    "I4": _make_ratio_check(3, 2, "I4"),
    "I6": _make_ratio_check(3, 4, "I6"),
    "I10": _make_ratio_check(4, 2, "I10"),
    "I15": _make_ratio_check(5, 2, "I15"),
}
