"""Quantities from which features of image moments are computed, and their compiled formulas."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .errors import UnavailableFeatureError
from .feature_formulas import DENOMINATORS, FORMULAS
from .formula import Formula, compile_formulas
from .moments import DENSE, exponents

OTHER_LEAVES = ("a", "xg", "yg", "a_star", "Z_star")  # quantities without formula, besides moments
CENTRED = 2  # row of mu00 in the array that `compute_moment_features` builds
_MOMENT = re.compile(r"(m|mu)(\d)(\d)\Z")


class FeatureNode(NamedTuple):
    """Formula of one feature, and the quantities from which the feature is computed.

    Attributes:
        formula: formula of the feature; None for a leaf.
        leaves: quantities that have no formula, such as moments.
        denominators: formulas that must not be zero.
    """

    formula: Formula | None
    leaves: frozenset[str]
    denominators: tuple[str, ...]


@cache
def make_node(name: str) -> FeatureNode:
    """Return the formula of a feature, of an expression of features, or of a leaf.

    Raises:
        UnavailableFeatureError: the name is neither a feature nor a formula.
    """
    own = (DENOMINATORS[name],) if name in DENOMINATORS else ()
    if name == "alpha_full":
        third = (name, "mu30", "mu21", "mu12", "mu03")
        return FeatureNode(None, frozenset((*third, *make_node("alpha").leaves)), own)
    if name in OTHER_LEAVES or parse_moment(name):
        return FeatureNode(None, frozenset((name,)), own)
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
    below = [make_node(n) for n in formula.names]
    denominators = dict.fromkeys((*own, *(d for n in below for d in n.denominators)))
    return FeatureNode(formula, frozenset().union(*(n.leaves for n in below)), tuple(denominators))


@cache
def parse_moment(leaf: str) -> tuple[str, int, int] | None:
    """Return ('m' or 'mu', i, j) for the name of a moment, otherwise None."""
    match = _MOMENT.match(leaf)
    return None if match is None else (match[1], int(match[2]), int(match[3]))


class FeaturePlan(NamedTuple):
    """The quantities from which a list of features is computed; it is cached for each list.

    A leaf is a quantity that has no formula, such as a moment. Its row is a row (6,) of the
    interaction matrix.

    Attributes:
        leaves: names of the leaves.
        centred_order: highest order of those centred moments whose rows must be computed.
        raw_order: highest order of those raw moments whose rows must be computed; -1 for none.
        row_indices: index of each leaf's row in the array that `compute_moment_features` builds.
        checked_names: names of the features that can be undefined.
    """

    leaves: tuple[str, ...]
    centred_order: int
    raw_order: int
    row_indices: NDArray[np.intp]
    checked_names: tuple[str, ...]


@lru_cache(maxsize=256)
def make_plan(names: tuple[str, ...], kind: str) -> FeaturePlan:
    """Return the quantities that features need from moments of a kind; see `Moments.kind`."""
    leaves = sorted(frozenset().union(*(make_node(name).leaves for name in names)))
    moments = [moment for leaf in leaves if (moment := parse_moment(leaf))]
    raw = [i + j for table, i, j in moments if table == "m"]
    centred = [i + j for table, i, j in moments if table == "mu"]
    if "a" in leaves and kind != DENSE:
        centred.append(2)  # the area of a set of points is mu20 + mu02
    centred_order, raw_order = max([1, *centred]), max([1, *raw]) if raw else -1
    # Order of the rows: xg, yg, all mu_ij, all m_ij, and the area of a set of points. The area of a
    # region is mu00. A quantity that does not depend on the camera has the row of mu10, which is 0.
    first_raw, area = CENTRED + len(exponents(centred_order)), CENTRED if kind == DENSE else -1

    def find_position(leaf: str) -> int:
        if moment := parse_moment(leaf):
            table, i, j = moment
            index = (i + j) * (i + j + 1) // 2 + j
            return index + (first_raw if table == "m" else CENTRED)
        return {"a": area, "xg": 0, "yg": 1}.get(leaf, CENTRED + 1)

    checked = tuple(n for n in names if make_node(n).denominators or n == "alpha_full")
    return FeaturePlan(
        tuple(leaves), centred_order, raw_order, np.array([find_position(n) for n in leaves]),
        checked,
    )  # fmt: skip


@lru_cache(maxsize=256)
def compile_plan(
    names: tuple[str, ...], leaves: tuple[str, ...]
) -> Callable[[list[list[float]], Mapping[str, float]], tuple]:
    """Compile the formulas of the features to a function of the centred moments.

    Arguments of the function are mu, with mu_ij at [i][j], and the values of all other leaves, by
    name.
    """

    def find_source(leaf: str) -> str:
        moment = parse_moment(leaf)
        is_centred = moment is not None and moment[0] == "mu"
        return f"mu[{moment[1]}][{moment[2]}]" if is_centred else f"others[{leaf!r}]"

    return compile_formulas(
        names, leaves, lambda name: make_node(name).formula, find_source, {"alpha_full": "alpha"}
    )


def compute_required_order(names: Iterable[str], kind: str = DENSE) -> int:
    """Return the order of moments that is needed to compute L of the features.

    This order is one higher than the order needed for the values of the features.

    Args:
        names: names of the features.
        kind: 'dense' for moments of a region, 'points' for moments of a set of points.
    """
    plan = make_plan(tuple(names), kind)
    return max(plan.centred_order, plan.raw_order) + 1
