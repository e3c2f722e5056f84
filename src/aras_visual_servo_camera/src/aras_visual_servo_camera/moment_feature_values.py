"""Visual features of image moments and their interaction matrices.

    result = compute_moment_features(moments, ("xn", "yn", "an", "alpha"), plane, reference)
    result.values    # s, (4,)
    result.L         # (4, 6): ds/dt = L v, where v is the camera's twist in its own optical frame

These names are features:
- any moment (m00, mu20, ...), xg, yg, area, xn, yn, an;
- alpha, the orientation of the main axis in (-pi/2, pi/2];
- alpha_full, the orientation relative to that of the desired view, in (-pi, pi];
- C1 ... C10, Sx, Sy, Px, Py, and the polynomials I1 ... I15 that define C1 ... C10.

An expression such as "C3 - 0.5 * C4" is also a feature. Its interaction matrix follows from the
chain rule.

If a feature is undefined for a shape (alpha of a square, a ratio 0/0), `degenerate` contains the
reason, and the value and the row of L are zero, not NaN.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from math import sqrt
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .degeneracy import CHECKS, DEFAULT_TOLERANCE
from .errors import DegenerateFeatureError, UnavailableFeatureError
from .feature_formulas import DENOMINATORS, FORMULAS
from .formula import CompiledFormulas, Formula
from .interaction import Plane, compute_centred_interaction, compute_raw_interaction
from .moments import DENSE, Moments, exponents
from .polygons import Array
from .target_orientation import TargetOrientation, full_alpha

PAPER_FEATURES = ("xn", "yn", "an", "alpha")

CENTRED = 2  # row of mu00 in the array that `_compute_leaf_rows` builds
_MOMENT = re.compile(r"(m|mu)(\d)(\d)\Z")


@dataclass(frozen=True)
class Reference:
    """Area, depth and orientation of the desired view, on which an, xn, yn and alpha_full depend.

    Attributes:
        area: a*, the `Moments.area` of the desired view.
        depth: Z*, depth of the target's plane on the optical axis in the desired view, m.
        orientation: orientation of the target in the desired view, for alpha_full; None if it is
            undefined.
    """

    area: float
    depth: float
    orientation: TargetOrientation | None = None

    def __post_init__(self) -> None:
        if not (self.area > 0.0 and self.depth > 0.0):
            raise UnavailableFeatureError(
                f"the reference needs a positive area and depth, got {self.area} and {self.depth}"
            )

    @classmethod
    def from_moments(cls, moments: Moments, depth: float, plane: Plane | None = None) -> Reference:
        """Return the reference of a desired view with the given moments and depth Z* (m).

        `plane` is the target's plane in that view; by default it is parallel to the image plane.
        If the order of the moments is below 3, the reference has no orientation.
        """
        plane = Plane.fronto_parallel(depth) if plane is None else plane
        return cls(moments.area, depth, TargetOrientation.from_moments(moments, plane))


@dataclass(eq=False)
class MomentFeatureValues:
    """Features of one view and their interaction matrix.

    Attributes:
        names: k names, in the requested order.
        values: (k,) values of the features, read-only.
        L: (k, 6) interaction matrix, read-only: d(values)/dt = L (vx, vy, vz, wx, wy, wz).
        degenerate: for each feature that is undefined for this shape, the reason. The keys are the
            names of the features.
        plane: the target's plane for which L was computed.
    """

    names: tuple[str, ...]
    values: Array
    L: Array
    degenerate: Mapping[str, str]
    plane: Plane

    @property
    def is_defined(self) -> bool:
        """True if every feature is defined."""
        return not self.degenerate

    def __getitem__(self, name: str) -> float:
        """Return the value of the feature with this name.

        Raises:
            DegenerateFeatureError: the feature is undefined for the shape in this view.
            UnavailableFeatureError: the feature was not computed.
        """
        return float(self.values[self._find_index(name)])

    def get_interaction_row(self, name: str) -> Array:
        """Return the row (6,) of the interaction matrix L for one feature.

        Raises:
            DegenerateFeatureError: the feature is undefined for the shape in this view.
            UnavailableFeatureError: the feature was not computed.
        """
        return self.L[self._find_index(name)]

    def _find_index(self, name: str) -> int:
        if name in self.degenerate:
            raise DegenerateFeatureError(name, self.degenerate[name])
        if name not in self.names:
            raise UnavailableFeatureError(
                f"feature '{name}' was not computed; the computed features are "
                f"{', '.join(self.names)}"
            )
        return self.names.index(name)


class _Node(NamedTuple):
    """Formula of one feature, and the quantities from which the feature is computed.

    `leaves` are the names of quantities that have no formula, such as moments. `denominators` are
    formulas that must not be zero.
    """

    # Formula of the feature; None for a quantity without formula, such as a moment.
    formula: Formula | None
    leaves: frozenset[str]
    denominators: tuple[str, ...]


@cache
def _make_node(name: str) -> _Node:
    own = (DENOMINATORS[name],) if name in DENOMINATORS else ()
    if name == "alpha_full":
        third = (name, "mu30", "mu21", "mu12", "mu03")
        return _Node(None, frozenset((*third, *_make_node("alpha").leaves)), own)
    if name in ("a", "xg", "yg", "a_star", "Z_star") or _parse_moment(name):
        return _Node(None, frozenset((name,)), own)
    formula = FORMULAS.get(name)
    if formula is None:
        if name.isidentifier():
            raise UnavailableFeatureError(
                f"there is no feature '{name}'; use one of mIJ, muIJ, xg, yg, alpha_full, "
                + ", ".join(FORMULAS)
            )
        try:
            formula = Formula(name)
        except (SyntaxError, ValueError) as error:
            raise UnavailableFeatureError(
                f"'{name}' is neither a feature nor a formula: {error}"
            ) from None
    below = [_make_node(n) for n in formula.names]
    denominators = dict.fromkeys((*own, *(d for n in below for d in n.denominators)))
    return _Node(formula, frozenset().union(*(n.leaves for n in below)), tuple(denominators))


@cache
def _parse_moment(leaf: str) -> tuple[str, int, int] | None:
    """Return ('m' or 'mu', i, j) for the name of a moment, otherwise None."""
    match = _MOMENT.match(leaf)
    return None if match is None else (match[1], int(match[2]), int(match[3]))


def _find_leaf_order(leaf: str, kind: str) -> int:
    if moment := _parse_moment(leaf):
        return moment[1] + moment[2]
    if leaf == "a":
        return 0 if kind == DENSE else 2
    return 1 if leaf in ("xg", "yg") else 0


class _Plan(NamedTuple):
    """The quantities from which a list of features is computed; it is cached for each list.

    A leaf is a quantity that has no formula, such as a moment. Its row is a row (6,) of the
    interaction matrix.

    Attributes:
        leaves: names of the leaves.
        centred_order: highest order of those centred moments whose rows must be computed.
        raw_order: highest order of those raw moments whose rows must be computed; -1 for none.
        row_indices: index of each leaf's row in the array that `_compute_leaf_rows` builds.
        checked_names: names of the features that can be undefined.
    """

    leaves: tuple[str, ...]
    centred_order: int
    raw_order: int
    row_indices: NDArray[np.intp]
    checked_names: tuple[str, ...]


@lru_cache(maxsize=256)
def _make_plan(names: tuple[str, ...], kind: str) -> _Plan:
    leaves = sorted(frozenset().union(*(_make_node(name).leaves for name in names)))
    raw = [_find_leaf_order(n, kind) for n in leaves if re.match(r"m\d", n)]
    rest = [_find_leaf_order(n, kind) for n in leaves if not re.match(r"m\d", n)]
    centred_order, raw_order = max([1, *rest]), max([1, *raw]) if raw else -1
    # Order of the rows: xg, yg, all mu_ij, all m_ij, and the area of a set of points. The area of a
    # region is mu00. A quantity that does not depend on the camera has the row of mu10, which is 0.
    first_raw, area = CENTRED + len(exponents(centred_order)), CENTRED if kind == DENSE else -1

    def find_position(leaf: str) -> int:
        if moment := _parse_moment(leaf):
            table, i, j = moment
            index = (i + j) * (i + j + 1) // 2 + j
            return index + (first_raw if table == "m" else CENTRED)
        return {"a": area, "xg": 0, "yg": 1}.get(leaf, CENTRED + 1)

    checked = tuple(n for n in names if _make_node(n).denominators or n == "alpha_full")
    return _Plan(
        tuple(leaves), centred_order, raw_order, np.array([find_position(n) for n in leaves]),
        checked,
    )  # fmt: skip


@lru_cache(maxsize=256)
def _compile_plan(names: tuple[str, ...], leaves: tuple[str, ...]) -> CompiledFormulas:
    return CompiledFormulas(
        names, lambda name: _make_node(name).formula, leaves, {"alpha_full": "alpha"}
    )


@lru_cache(maxsize=256)
def _list_leaf_indices(
    names: tuple[str, ...], leaves: tuple[str, ...]
) -> tuple[tuple[str, tuple[int, int] | None], ...]:
    """Return the name of each leaf and its indices: (i, j) for a centred moment mu_ij, else None.

    A leaf is a quantity that has no formula, such as a moment. The result for a leaf that affects
    none of the features is ('', None).
    """
    used, found = _compile_plan(names, leaves).used_leaves, []
    for name in leaves:
        moment = _parse_moment(name)
        indices = moment[1:] if moment is not None and moment[0] == "mu" else None
        found.append((name, indices) if name in used else ("", None))
    return tuple(found)


def compute_required_order(names: Iterable[str], kind: str = DENSE) -> int:
    """Return the order of moments that is needed to compute L of the features.

    This order is one higher than the order needed for the values of the features.

    Args:
        names: names of the features.
        kind: 'dense' for moments of a region, 'points' for moments of a set of points.
    """
    plan = _make_plan(tuple(names), kind)
    return max(plan.centred_order, plan.raw_order) + 1


def compute_moment_features(
    moments: Moments,
    names: Sequence[str] = PAPER_FEATURES,
    plane: Plane | None = None,
    reference: Reference | None = None,
    tolerance: float = DEFAULT_TOLERANCE,
) -> MomentFeatureValues:
    """Compute features of image moments and their interaction matrix, ds/dt = L v.

    v is the twist of the camera in its own optical frame, m/s and rad/s. Source: F. Chaumette, IEEE
    T-RO 20(4), 2004; O. Tahri and F. Chaumette, IEEE T-RO 21(6), 2005.

    Args:
        moments: moments of the current view.
        names: features such as 'xn', 'alpha' or 'C3 - 0.5 * C4'; this module's docstring lists
            them.
        plane: target's plane in the current optical frame, 1/Z = A x + B y + C. By default, it is
            parallel to the image plane at the depth Z* sqrt(a* / a). a is the area of `moments`;
            a* and Z* are the area and the depth of `reference`.
        reference: desired view, for an, xn, yn, alpha_full and the default plane.
        tolerance: dimensionless size below which a denominator is treated as zero: 1e-9 for
            rounding errors, about 1e-2 for a noisy image of a square.

    Returns:
        The values s (k,), L (k, 6), and for each feature that is undefined for this shape the
        reason.

    Raises:
        UnavailableFeatureError: a name is unknown, the order of the moments is too low, or a
            reference is missing.
    """
    names = tuple(names)
    plane = _make_plane(moments, reference) if plane is None else plane
    view, plan = _View(moments, plane, reference, tolerance), _make_plan(names, moments.kind)
    values, rows, degenerate = view.evaluate_defined(names, plan)
    L = np.array(rows) @ _compute_leaf_rows(moments, plane, plan)
    L.setflags(write=False)
    return MomentFeatureValues(names, values, L, MappingProxyType(degenerate), plane)


def compute_feature_values(
    moments: Moments,
    names: tuple[str, ...],
    plane: Plane,
    reference: Reference | None = None,
    tolerance: float = DEFAULT_TOLERANCE,
) -> Array:
    """Compute the values (k,) of `compute_moment_features` without L.

    Raises:
        UnavailableFeatureError: a name is unknown, the order of the moments is too low, or a
            reference is missing.
    """
    plan = _make_plan(names, moments.kind)
    return _View(moments, plane, reference, tolerance).evaluate_defined(names, plan)[0]


def _make_plane(moments: Moments, reference: Reference | None) -> Plane:
    """Return the plane parallel to the image plane at the depth Z* sqrt(a* / a).

    a is the current area. a* and Z* are the desired area and depth, from `reference`.
    """
    if reference is None:
        raise UnavailableFeatureError(
            "the depth of the target is unknown; give a plane, or a reference with the desired "
            "area and depth"
        )
    if not moments.area > 0.0:
        raise UnavailableFeatureError(
            "all points coincide, so their depth cannot be computed; give a plane"
        )
    return Plane.fronto_parallel(reference.depth * sqrt(reference.area / moments.area))


def _compute_leaf_rows(moments: Moments, plane: Plane, plan: _Plan) -> Array:
    """Compute the interaction matrix (n, 6) of the n quantities in plan.leaves, in their order."""
    rows = compute_centred_interaction(moments, plane, plan.centred_order)
    if plan.raw_order > 0:
        rows = np.vstack([rows, compute_raw_interaction(moments, plane, plan.raw_order)])
    if moments.kind != DENSE and "a" in plan.leaves:
        rows = np.vstack([rows, rows[CENTRED + 3] + rows[CENTRED + 5]])
    return rows.take(plan.row_indices, axis=0)


class _View:
    """Values of features in one view, and their derivatives with respect to the moments."""

    def __init__(
        self, moments: Moments, plane: Plane, reference: Reference | None, tolerance: float
    ) -> None:
        self.moments = moments
        self.plane = plane
        self.reference = reference
        self.tolerance = tolerance
        self._mu = moments.centred.tolist()
        self._leaves = {"a": moments.area, "xg": moments.xg, "yg": moments.yg, "": 0.0}
        if reference is not None:
            self._leaves |= {"a_star": reference.area, "Z_star": reference.depth}

    def evaluate_defined(
        self, names: tuple[str, ...], plan: _Plan
    ) -> tuple[Array, tuple[tuple[float, ...], ...], dict[str, str]]:
        """Evaluate the features, with zeros for those that are undefined.

        Returns:
            The values (k,); for each feature, its derivatives with respect to the quantities in
            plan.leaves; and for each undefined feature, the reason. The keys are the names of the
            features.

        Raises:
            UnavailableFeatureError: the order of the moments is too low.
        """
        order, needed = self.moments.order, max(plan.centred_order, plan.raw_order) + 1
        if order < needed:
            raise UnavailableFeatureError(
                f"{', '.join(names)} need moments up to order {needed} for the interaction matrix, "
                f"got order {order}; increase the order of the moments"
            )
        degenerate = {}
        for name in plan.checked_names:
            if (reason := self.explain_undefined(name)) is not None:
                degenerate[name] = reason
        defined = tuple(n for n in names if n not in degenerate) if degenerate else names
        try:
            values, rows = self.evaluate(defined, plan.leaves)
        except ZeroDivisionError:
            values, rows = [], []
            for name in defined:
                try:
                    (value,), (row,) = self.evaluate((name,), plan.leaves)
                except ZeroDivisionError:
                    degenerate[name] = (
                        f"'{name}' divides by zero for this shape; use another feature"
                    )
                else:
                    values.append(value)
                    rows.append(row)
        if degenerate:
            zeros, remaining = (0.0, (0.0,) * len(plan.leaves)), zip(values, rows, strict=True)
            results = [zeros if name in degenerate else next(remaining) for name in names]
            values, rows = zip(*results, strict=True)
        values = np.array(values)
        values.setflags(write=False)
        return values, rows, degenerate

    def explain_undefined(self, name: str) -> str | None:
        """Return the reason why the feature is undefined, or None if it is defined."""
        for denominator in _make_node(name).denominators:
            value = self._get_value(denominator) if denominator in FORMULAS else 0.0
            reason = CHECKS[denominator](self.moments, value, self.tolerance)
            if reason is not None:
                return reason
        if name == "alpha_full" and self._get_reference(name).orientation is None:
            return (
                "the orientation of the desired view is undefined; use another target or feature "
                "alpha"
            )
        return None

    def evaluate(
        self, names: tuple[str, ...], leaves: tuple[str, ...]
    ) -> tuple[tuple[float, ...], tuple[tuple[float, ...], ...]]:
        """Return the values of the features, and their derivatives with respect to `leaves`.

        leaves: names of quantities without formula, such as moments.

        Raises:
            ZeroDivisionError: a feature divides by zero.
        """
        values = []
        for name, indices in _list_leaf_indices(names, leaves):
            if indices is not None:
                values.append(self._mu[indices[0]][indices[1]])
            elif name in self._leaves:
                values.append(self._leaves[name])
            else:
                values.append(self._get_leaf(name))
        return _compile_plan(names, leaves).evaluate(*values)

    def _get_value(self, name: str) -> float:
        return self.evaluate((name,), tuple(sorted(_make_node(name).leaves)))[0][0]

    def _get_leaf(self, name: str) -> float:
        """Return the value of a moment, or of alpha_full; these quantities have no formula."""
        moments = self.moments
        if moment := _parse_moment(name):
            return moments.m(*moment[1:])
        orientation = self._get_reference(name).orientation
        return full_alpha(moments, self._get_value("alpha"), self.plane, orientation)

    def _get_reference(self, name: str) -> Reference:
        if self.reference is None:
            raise UnavailableFeatureError(f"'{name}' needs a reference: the desired area and depth")
        return self.reference
