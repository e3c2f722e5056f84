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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import sqrt
from types import MappingProxyType

import numpy as np

from .degeneracy import CHECKS, DEFAULT_TOLERANCE
from .errors import DegenerateFeatureError, UnavailableFeatureError
from .feature_formulas import FORMULAS
from .feature_plan import CENTRED, FeaturePlan, compile_plan, make_node, make_plan, parse_moment
from .interaction import Plane, compute_centred_rows, compute_raw_interaction
from .moments import DENSE, Moments
from .polygons import Array
from .target_orientation import TargetOrientation, full_alpha

PAPER_FEATURES = ("xn", "yn", "an", "alpha")


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

    def __getitem__(self, name: str) -> float:
        """Return the value of the feature with this name.

        Raises:
            DegenerateFeatureError: the feature is undefined for the shape in this view.
            UnavailableFeatureError: the feature was not computed.
        """
        if name in self.degenerate:
            raise DegenerateFeatureError(name, self.degenerate[name])
        if name not in self.names:
            raise UnavailableFeatureError(
                f"feature '{name}' was not computed; the computed features are "
                f"{', '.join(self.names)}"
            )
        return float(self.values[self.names.index(name)])


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
    view, plan = _View(moments, plane, reference, tolerance), make_plan(names, moments.kind)
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
    plan = make_plan(names, moments.kind)
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


def _compute_leaf_rows(moments: Moments, plane: Plane, plan: FeaturePlan) -> Array:
    """Compute the interaction matrix (n, 6) of the n quantities in plan.leaves, in their order."""
    rows = compute_centred_rows(
        moments.centred, *plane, moments.xg, moments.yg, plan.centred_order,
        1.0 if moments.kind == DENSE else 0.0,
    )  # fmt: skip
    if plan.raw_order > 0:
        rows = np.vstack([rows, compute_raw_interaction(moments, plane, plan.raw_order)])
    if moments.kind != DENSE and "a" in plan.leaves:
        rows = np.vstack([rows, rows[CENTRED + 3] + rows[CENTRED + 5]])
    return rows.take(plan.row_indices, axis=0)


class _View(dict[str, float]):
    """Values of features in one view, and their derivatives with respect to the moments.

    The mapping contains the quantities without formula, except the centred moments. Those that are
    rarely needed are computed at their first use.
    """

    def __init__(
        self, moments: Moments, plane: Plane, reference: Reference | None, tolerance: float
    ) -> None:
        self.moments = moments
        self.plane = plane
        self.reference = reference
        self.tolerance = tolerance
        self._mu = moments.centred.tolist()
        self["a"], self["xg"], self["yg"] = moments.area, moments.xg, moments.yg
        if reference is not None:
            self["a_star"], self["Z_star"] = reference.area, reference.depth

    def evaluate_defined(
        self, names: tuple[str, ...], plan: FeaturePlan
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
            if (reason := self._explain_undefined(name)) is not None:
                degenerate[name] = reason
        defined = tuple(n for n in names if n not in degenerate) if degenerate else names
        try:
            values, rows = compile_plan(defined, plan.leaves)(self._mu, self)
        except ZeroDivisionError:
            for name in defined:
                try:
                    compile_plan((name,), plan.leaves)(self._mu, self)
                except ZeroDivisionError:
                    degenerate[name] = (
                        f"'{name}' divides by zero for this shape; use another feature"
                    )
            defined = tuple(n for n in names if n not in degenerate)
            values, rows = compile_plan(defined, plan.leaves)(self._mu, self)
        if degenerate:
            zeros, remaining = (0.0, (0.0,) * len(plan.leaves)), zip(values, rows, strict=True)
            results = [zeros if name in degenerate else next(remaining) for name in names]
            values, rows = zip(*results, strict=True)
        values = np.array(values)
        values.setflags(write=False)
        return values, rows, degenerate

    def _explain_undefined(self, name: str) -> str | None:
        """Return the reason why the feature is undefined, or None if it is defined."""
        for denominator in make_node(name).denominators:
            value = self._compute_value(denominator) if denominator in FORMULAS else 0.0
            reason = CHECKS[denominator](self.moments, value, self.tolerance)
            if reason is not None:
                return reason
        if name == "alpha_full" and self._get_reference(name).orientation is None:
            return (
                "the orientation of the desired view is undefined; use another target or feature "
                "alpha"
            )
        return None

    def _compute_value(self, name: str) -> float:
        leaves = tuple(sorted(make_node(name).leaves))
        return compile_plan((name,), leaves)(self._mu, self)[0][0]

    def __missing__(self, name: str) -> float:
        """Return the value of a raw moment, or of alpha_full."""
        if moment := parse_moment(name):
            return self.moments.m(*moment[1:])
        orientation = self._get_reference(name).orientation
        return full_alpha(self.moments, self._compute_value("alpha"), self.plane, orientation)

    def _get_reference(self, name: str) -> Reference:
        if self.reference is None:
            raise UnavailableFeatureError(f"'{name}' needs a reference: the desired area and depth")
        return self.reference
