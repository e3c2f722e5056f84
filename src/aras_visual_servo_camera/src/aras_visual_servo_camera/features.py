"""Visual features of a target and their interaction matrices, as one immutable result.

    result = compute(moments, ("xn", "yn", "an", "alpha"), plane, reference)
    result.values    # s, (4,)
    result.L         # ds/dt = L v, (4, 6), v the camera's twist in its own optical frame

Names: m00 ... , mu20 ... (any moment), xg, yg, area, xn, yn, an, alpha (symmetric, in
(-pi/2, pi/2]), alpha_full (reference-based, in (-pi, pi]), C1 ... C10, Sx, Sy, Px, Py, and the
polynomials I1 ... I15 behind them.

A feature that a shape leaves undefined (the alpha of a square, a ratio 0/0) is listed in
`degenerate` with the reason; its value and row are zero, never NaN.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from types import MappingProxyType

import numpy as np

from .definitions import DENOMINATORS, FORMULAS
from .degeneracy import CHECKS, DEFAULT_TOLERANCE
from .errors import DegenerateFeatureError, FeatureError
from .interaction import CentredRows, MomentRows, Plane, centred_rows, raw_rows
from .moments import DENSE, Array, Moments
from .orientation import full_alpha

PAPER = ("xn", "yn", "an", "alpha")
INVARIANTS = tuple(f"C{k}" for k in range(1, 11)) + ("Sx", "Sy", "Px", "Py")

_MOMENT = re.compile(r"(m|mu)(\d)(\d)\Z")


@dataclass(frozen=True)
class Reference:
    """What the desired view looks like: needed by an, xn, yn and alpha_full.

    Attributes:
        area: a*, the `Moments.area` of the desired view.
        depth: Z*, m, of the target's plane along the optical axis in the desired view.
        alpha: orientation in the desired view, rad; None if alpha_full is not used.
        third: mu30, mu21, mu12, mu03 of the desired view; None likewise.
        third_scale: m00 rg^3 of the desired view, which `third` is measured by.
    """

    area: float
    depth: float
    alpha: float | None = None
    third: tuple[float, float, float, float] | None = None
    third_scale: float = 0.0

    def __post_init__(self) -> None:
        if not (self.area > 0.0 and self.depth > 0.0):
            raise FeatureError(
                f"the reference needs a positive area and depth, got {self.area} and {self.depth}"
            )

    @classmethod
    def from_moments(cls, moments: Moments, depth: float) -> Reference:
        """From the moments of the desired view and its depth Z* (m).

        Orders below 3 give a reference without `alpha` and `third`.
        """
        if moments.order < 3:
            return cls(moments.area, depth)
        from .degeneracy import gyration_radius

        angle = compute(moments, ("alpha",), Plane.fronto_parallel(depth))
        mu = moments.mu
        return cls(
            moments.area,
            depth,
            None if angle.degenerate else float(angle.values[0]),
            (mu(3, 0), mu(2, 1), mu(1, 2), mu(0, 3)),
            moments.m00 * gyration_radius(moments) ** 3,
        )


@dataclass(frozen=True, eq=False)
class FeatureSet:
    """Features and their interaction matrix.

    Attributes:
        names: k names, in the order asked for.
        values: (k,) read-only.
        L: (k, 6) read-only; d(values)/dt = L (vx, vy, vz, wx, wy, wz).
        degenerate: name -> reason, for those that this shape leaves undefined.
        plane: the plane that L was worked out for.
    """

    names: tuple[str, ...]
    values: Array
    L: Array
    degenerate: Mapping[str, str]
    plane: Plane

    @property
    def ok(self) -> bool:
        """True if every feature is defined."""
        return not self.degenerate

    def __getitem__(self, name: str) -> float:
        """Value of one feature. Raises DegenerateFeatureError or FeatureError."""
        return float(self.values[self._index(name)])

    def row(self, name: str) -> Array:
        """L of one feature, (6,). Raises DegenerateFeatureError or FeatureError."""
        return self.L[self._index(name)]

    def _index(self, name: str) -> int:
        if name in self.degenerate:
            raise DegenerateFeatureError(name, self.degenerate[name])
        if name not in self.names:
            raise FeatureError(f"feature '{name}' was not computed; there are {self.names}")
        return self.names.index(name)


@cache
def _leaves(name: str) -> frozenset[str]:
    """The moments, a, xg, yg and reference values that a feature comes down to."""
    if name in FORMULAS:
        return frozenset().union(*(_leaves(n) for n in FORMULAS[name].names))
    if name == "alpha_full":
        return frozenset(("mu30", "mu21", "mu12", "mu03")) | _leaves("alpha")
    if name in ("a", "xg", "yg", "a_star", "Z_star") or _MOMENT.match(name):
        return frozenset((name,))
    raise FeatureError(
        f"there is no feature '{name}'; known are mIJ, muIJ, xg, yg, alpha_full, "
        + ", ".join(n for n in FORMULAS)
    )


def _leaf_order(leaf: str, kind: str) -> int:
    if match := _MOMENT.match(leaf):
        return int(match[2]) + int(match[3])
    if leaf == "a":
        return 0 if kind == DENSE else 2
    return 1 if leaf in ("xg", "yg") else 0


@lru_cache(maxsize=256)
def _orders(names: tuple[str, ...], kind: str) -> tuple[int, int]:
    leaves = frozenset().union(*(_leaves(name) for name in names))
    centred = [_leaf_order(n, kind) for n in leaves if not re.match(r"m\d", n)]
    raw = [_leaf_order(n, kind) for n in leaves if re.match(r"m\d", n)]
    return max(centred, default=-1), max(raw, default=-1)


def required_order(names: Iterable[str], kind: str = DENSE) -> int:
    """Order of moments that the features and their L need: one more than their values do."""
    return max(1, *_orders(tuple(names), kind)) + 1


def compute(
    moments: Moments,
    names: Sequence[str] = PAPER,
    plane: Plane | None = None,
    reference: Reference | None = None,
    tolerance: float = DEFAULT_TOLERANCE,
) -> FeatureSet:
    """Features `names` of the target with their interaction matrix.

    Args:
        moments: of the current view.
        names: see the head of this module.
        plane: target's plane in the current optical frame; without it the plane is taken as
            square to the optical axis, at the depth at which the area matches the reference.
        reference: the desired view, for an, xn, yn, alpha_full and the default plane.
        tolerance: dimensionless size below which a denominator counts as zero; rounding needs
            1e-9, a noisy image of a square rather 1e-2.

    Raises:
        FeatureError: unknown name, order of moments too low, or no reference where one is needed.
    """
    names = tuple(names)
    if plane is None:
        if reference is None:
            raise FeatureError("give a plane, or a reference that its depth can be taken from")
        plane = Plane.fronto_parallel(reference.depth * (reference.area / moments.area) ** 0.5)
    state = _State(moments, names, plane, reference, tolerance)
    values, L = np.zeros(len(names)), np.zeros((len(names), 6))
    degenerate: dict[str, str] = {}
    for k, name in enumerate(names):
        reason = state.undefined(name)
        if reason is None:
            values[k], L[k] = state.evaluate(name)
        else:
            degenerate[name] = reason
    values.setflags(write=False)
    L.setflags(write=False)
    return FeatureSet(names, values, L, MappingProxyType(degenerate), plane)


class _State:
    """Values and rows of one view, each worked out once."""

    def __init__(
        self,
        moments: Moments,
        names: tuple[str, ...],
        plane: Plane,
        reference: Reference | None,
        tolerance: float,
    ) -> None:
        centred_order, raw_order = _orders(names, moments.kind)
        needed = required_order(names, moments.kind)
        if moments.order < needed:
            raise FeatureError(
                f"{', '.join(names)} need moments up to order {needed} (one more than their "
                f"values, for L); these go up to {moments.order}"
            )
        self.moments = moments
        self.plane = plane
        self.reference = reference
        self.tolerance = tolerance
        self.known: dict[str, tuple[float, Array | None]] = {}
        self.centred: CentredRows = centred_rows(moments, plane, max(centred_order, 1))
        self.raw: MomentRows | None = (
            raw_rows(moments, plane, max(raw_order, 1)) if raw_order >= 0 else None
        )

    def undefined(self, name: str) -> str | None:
        denominator = DENOMINATORS.get(name)
        if denominator is None:
            return None
        value = self.evaluate(denominator)[0] if denominator in FORMULAS else 0.0
        reason = CHECKS[denominator](self.moments, value, self.tolerance)
        if reason is None and name == "alpha_full" and self._reference(name).alpha is None:
            reason = "the reference has no main axis, hence no orientation to compare with"
        return reason

    def evaluate(self, name: str) -> tuple[float, Array | None]:
        known = self.known.get(name)
        if known is None:
            formula = FORMULAS.get(name)
            known = self._leaf(name) if formula is None else self._formula(formula)
            self.known[name] = known
        return known

    def _formula(self, formula) -> tuple[float, Array]:
        arguments = [self.evaluate(name) for name in formula.names]
        value, *partials = formula.value_and_partials([a[0] for a in arguments])
        row = np.zeros(6)
        for (_, argument_row), partial in zip(arguments, partials, strict=True):
            if argument_row is not None and partial != 0.0:
                row += partial * argument_row
        return value, row

    def _leaf(self, name: str) -> tuple[float, Array | None]:
        moments, rows = self.moments, self.centred
        if match := _MOMENT.match(name):
            i, j = int(match[2]), int(match[3])
            if match[1] == "m":
                return moments.m(i, j), self.raw.row(i, j)
            return moments.mu(i, j), rows.mu.row(i, j)
        if name == "a":
            if moments.kind == DENSE:
                return moments.m00, rows.area
            return moments.area, rows.mu.row(2, 0) + rows.mu.row(0, 2)
        if name == "xg":
            return moments.xg, rows.xg
        if name == "yg":
            return moments.yg, rows.yg
        if name == "alpha_full":
            value, row = self.evaluate("alpha")
            return full_alpha(moments, value, self._reference(name), self.plane), row
        reference = self._reference(name)
        return (reference.area if name == "a_star" else reference.depth), None

    def _reference(self, name: str) -> Reference:
        if self.reference is None:
            raise FeatureError(f"'{name}' needs a reference: the desired area and depth")
        return self.reference
