"""Interaction matrices of moments: how they change when the camera moves.

    d(m_ij)/dt = L (vx, vy, vz, wx, wy, wz),   twist of the camera in its own optical frame.

One derivation serves raw and centred moments. A point of the plane 1/Z = A x + B y + C, seen
from a camera that moves, travels through the image with

    x' = -vx/Z + x vz/Z + x y wx - (1 + x^2) wy + y wz
    y' = -vy/Z + y vz/Z + (1 + y^2) wx - x y wy - x wz,

for each twist component a polynomial of degree two in x and y. About any origin (x0, y0) it is
again one, so with a = x - x0, b = y - y0

    d(m_ij)/dt = integral of (i a^(i-1) b^j x' + j a^i b^(j-1) y' + delta a^i b^j div(x', y')),

which is a linear combination of moments up to order i + j + 1. delta is 1 for a region (its
boundary moves with the points) and 0 for a set of points. For centred moments the origin is the
centre of gravity and its own velocity is taken off x' and y'.

Reference: F. Chaumette, Image moments: a general and useful set of features for visual
servoing, IEEE Transactions on Robotics 20(4), 2004, where the same rows are given term by term.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import FeatureError
from .moments import DENSE, Array, Moments, exponents

# The monomials 1, a, b, a^2, ab, b^2 as exponents of (a, b).
_MONOMIALS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))


class Plane(NamedTuple):
    """Plane of the target in the camera's optical frame, 1/Z = A x + B y + C; A, B, C in 1/m."""

    A: float
    B: float
    C: float

    @classmethod
    def fronto_parallel(cls, Z: float) -> Plane:
        """The plane at depth Z (m) square to the optical axis."""
        if not Z > 0.0:
            raise FeatureError(f"the depth of the target's plane must be positive, got {Z:g} m")
        return cls(0.0, 0.0, 1.0 / Z)

    @classmethod
    def from_pose(cls, R: ArrayLike, t: ArrayLike) -> Plane:
        """The plane z = 0 of an object frame with rotation R (3, 3) and origin t (3,), m."""
        normal = np.asarray(R, dtype=float)[:, 2]
        distance = float(normal @ np.asarray(t, dtype=float))
        if distance == 0.0:
            raise FeatureError("the target's plane passes through the camera: nothing to be seen")
        A, B, C = normal / distance
        return cls(float(A), float(B), float(C))

    def inverse_depth(self, x: float, y: float) -> float:
        """1/Z of the plane's point that is seen at (x, y), 1/m."""
        return self.A * x + self.B * y + self.C


def image_velocity(plane: Plane, x0: float, y0: float) -> tuple[Array, Array, Array]:
    """Velocity field of the plane's image about (x0, y0).

    Returns:
        x', y' and their divergence as (6, 6), (6, 6) and (6, 3) arrays: a row per twist
        component, a column per monomial 1, a, b, a^2, ab, b^2 (the divergence: 1, a, b).
    """
    A, B, _ = plane
    C = plane.inverse_depth(x0, y0)
    u = np.array(
        [
            [-C, -A, -B, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            [x0 * C, C + x0 * A, x0 * B, A, B, 0.0],
            [x0 * y0, y0, x0, 0.0, 1.0, 0.0],
            [-1.0 - x0 * x0, -2.0 * x0, 0.0, -1.0, 0.0, 0.0],
            [y0, 0.0, 1.0, 0.0, 0.0, 0.0],
        ]
    )
    v = np.array(
        [
            [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            [-C, -A, -B, 0.0, 0.0, 0.0],
            [y0 * C, y0 * A, C + y0 * B, 0.0, A, B],
            [1.0 + y0 * y0, 0.0, 2.0 * y0, 0.0, 0.0, 1.0],
            [-x0 * y0, -y0, -x0, 0.0, -1.0, 0.0],
            [-x0, -1.0, 0.0, 0.0, 0.0, 0.0],
        ]
    )
    divergence = np.array(
        [
            [-A, 0.0, 0.0],
            [-B, 0.0, 0.0],
            [2.0 * C + x0 * A + y0 * B, 3.0 * A, 3.0 * B],
            [3.0 * y0, 0.0, 3.0],
            [-3.0 * x0, -3.0, 0.0],
            [0.0, 0.0, 0.0],
        ]
    )
    return u, v, divergence


class MomentRows(NamedTuple):
    """Interaction matrices of every moment up to one order, in exchange order.

    Attributes:
        rows: ((order+1)(order+2)/2, 6).
        order: highest i + j that has a row.
    """

    rows: Array
    order: int

    def row(self, i: int, j: int) -> Array:
        """L of the moment (i, j), shape (6,)."""
        n = i + j
        return self.rows[n * (n + 1) // 2 + j]


class CentredRows(NamedTuple):
    """Interaction matrices of m00, the centre of gravity and the centred moments."""

    area: Array
    xg: Array
    yg: Array
    mu: MomentRows


def raw_rows(moments: Moments, plane: Plane, order: int | None = None) -> MomentRows:
    """L of every m_ij with i + j <= order (default and at most moments.order - 1)."""
    order = _row_order(moments, order)
    u, v, divergence = image_velocity(plane, 0.0, 0.0)
    delta = 1.0 if moments.kind == DENSE else 0.0
    return MomentRows(_rows(moments.raw, order, u, v, delta * divergence), order)


def centred_rows(moments: Moments, plane: Plane, order: int | None = None) -> CentredRows:
    """L of m00, xg, yg and every mu_ij, i + j <= order (default and at most moments.order - 1)."""
    order = _row_order(moments, order)
    u, v, divergence = image_velocity(plane, moments.xg, moments.yg)
    if moments.kind != DENSE:
        divergence = 0.0 * divergence
    # About the centre of gravity mu10 = mu01 = 0, so L_xg = L_m10 / m00 without a quotient rule.
    first = _rows(moments.centred, 1, u, v, divergence)
    xg, yg = first[1] / moments.m00, first[2] / moments.m00
    u[:, 0] -= xg
    v[:, 0] -= yg
    rows = _rows(moments.centred, order, u, v, divergence)
    rows[1:3] = 0.0
    return CentredRows(first[0], xg, yg, MomentRows(rows, order))


def _row_order(moments: Moments, order: int | None) -> int:
    highest = moments.order - 1
    if order is None:
        order = highest
    if not 1 <= order <= highest:
        raise FeatureError(
            f"interaction rows of order {order} need moments up to order {order + 1}; "
            f"these go up to {moments.order}"
        )
    return order


@cache
def _gather(order: int, size: int) -> tuple[NDArray[np.intp], Array]:
    """Where in a flat (size, size) table the moments of each product stand.

    An exponent outside the table only occurs with the factor i = 0 or j = 0: any place will do.
    """
    pairs = exponents(order)

    def place(i: int, j: int) -> int:
        return i * size + j if min(i, j) >= 0 and i + j <= order + 1 else 0

    x = [[place(i - 1 + p, j + q) for p, q in _MONOMIALS] for i, j in pairs]
    y = [[place(i + p, j - 1 + q) for p, q in _MONOMIALS] for i, j in pairs]
    d = [[place(i + p, j + q) for p, q in _MONOMIALS[:3]] for i, j in pairs]
    factor = np.ones((len(pairs), 15))
    factor[:, :6] = np.array([[i] for i, _ in pairs])
    factor[:, 6:12] = np.array([[j] for _, j in pairs])
    places = np.concatenate([np.array(x), np.array(y), np.array(d)], axis=1)
    return places, factor


def _rows(table: Array, order: int, u: Array, v: Array, divergence: Array) -> Array:
    places, factor = _gather(order, table.shape[0])
    integrals = table.ravel()[places] * factor
    return integrals @ np.concatenate((u, v, divergence), axis=1).T
