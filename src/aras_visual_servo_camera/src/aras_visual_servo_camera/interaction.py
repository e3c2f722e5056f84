"""Interaction matrices of moments and points: how they change when the camera moves.

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

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from aras_visual_servo_base.compiled import jit

from .errors import FeatureError
from .moments import DENSE, Moments
from .polygons import Array

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


def point_interaction(points: np.ndarray, inverse_depth: np.ndarray) -> np.ndarray:
    """Return the interaction matrix of image points, d(x, y)/dt = L v.

    The equation is that of this module; v is the twist of the camera in its own optical frame.

    Args:
        points: (n, 2) normalised coordinates x = X/Z, y = Y/Z.
        inverse_depth: (n,) 1/Z of each point along the optical axis, 1/m.

    Returns:
        (2n, 6) with the rows x_0, y_0, x_1, ...
    """
    x, y = np.asarray(points, float).T
    w = np.asarray(inverse_depth, float)
    L = np.zeros((len(x), 2, 6))
    L[:, 0, 0] = L[:, 1, 1] = -w
    L[:, 0, 2], L[:, 1, 2] = x * w, y * w
    L[:, 0, 3], L[:, 1, 3] = x * y, 1.0 + y * y
    L[:, 0, 4], L[:, 1, 4] = -1.0 - x * x, -x * y
    L[:, 0, 5], L[:, 1, 5] = y, -x
    return L.reshape(-1, 6)


@jit("f8, f8, f8, f8, f8")
def image_velocity(A, B, C, x0, y0):
    """Velocity field of the image of the plane (A, B, C) about (x0, y0), a = x - x0, b = y - y0.

    Returns:
        (6, 15): a row per twist component; columns 0-5 the coefficients of 1, a, b, a^2, ab, b^2
        in x', 6-11 the same of y', 12-14 those of 1, a, b in the divergence.
    """
    C = A * x0 + B * y0 + C
    Ax, Ay, Bx, By, xy = A * x0, A * y0, B * x0, B * y0, x0 * y0
    field = np.zeros((6, 15))
    row = field[0]
    row[0], row[1], row[2], row[12] = -C, -A, -B, -A
    row = field[1]
    row[6], row[7], row[8], row[12] = -C, -A, -B, -B
    row = field[2]
    row[0], row[1], row[2], row[3], row[4] = x0 * C, C + Ax, Bx, A, B
    row[6], row[7], row[8], row[10], row[11] = y0 * C, Ay, C + By, A, B
    row[12], row[13], row[14] = 2.0 * C + Ax + By, 3.0 * A, 3.0 * B
    row = field[3]
    row[0], row[1], row[2], row[4] = xy, y0, x0, 1.0
    row[6], row[8], row[11] = 1.0 + y0 * y0, 2.0 * y0, 1.0
    row[12], row[14] = 3.0 * y0, 3.0
    row = field[4]
    row[0], row[1], row[3] = -1.0 - x0 * x0, -2.0 * x0, -1.0
    row[6], row[7], row[8], row[10] = -xy, -y0, -x0, -1.0
    row[12], row[13] = -3.0 * x0, -3.0
    row = field[5]
    row[0], row[2], row[6], row[7] = y0, 1.0, -x0, -1.0
    return field


def compute_raw_interaction(moments: Moments, plane: Plane, order: int | None = None) -> Array:
    """L ((order+1)(order+2)/2, 6) of every m_ij with i + j <= order, in exchange order.

    order: default and at most moments.order - 1.
    """
    order = _find_order(moments, order)
    return _compute_rows(
        moments.raw, image_velocity(*plane, 0.0, 0.0), order, _compute_divergence(moments)
    )


def compute_centred_interaction(
    moments: Moments, plane: Plane, order: int | None = None
) -> tuple[Array, Array]:
    """L of the centre of gravity, (2, 6) of xg and yg, and of every mu_ij, as
    `compute_raw_interaction`.
    """
    order = _find_order(moments, order)
    return _compute_centred_rows(
        moments.centred, *plane, moments.xg, moments.yg, order, _compute_divergence(moments)
    )


def _find_order(moments: Moments, order: int | None) -> int:
    highest = moments.order - 1
    if order is None:
        order = highest
    if not 1 <= order <= highest:
        raise FeatureError(
            f"interaction rows of order {order} need moments up to order {order + 1}; "
            f"these go up to {moments.order}"
        )
    return order


def _compute_divergence(moments: Moments) -> float:
    """delta: whether the boundary moves with the points."""
    return 1.0 if moments.kind == DENSE else 0.0


@jit("f8[:,:], f8[:,:], i8, f8")
def _compute_rows(table, velocity, order, delta):
    """((order+1)(order+2)/2, 6) d(m_ij)/dt in exchange order, of moments (n, n) in a field of
    velocities (6, 15) as image_velocity() gives it."""
    rows, row = np.zeros(((order + 1) * (order + 2) // 2, 6)), 0
    for n in range(order + 1):
        for j in range(n + 1):
            i = n - j
            for k in range(6):
                p, q = _MONOMIALS[k]
                of_x = i * table[i - 1 + p, j + q] if i > 0 else 0.0
                of_y = j * table[i + p, j - 1 + q] if j > 0 else 0.0
                spread = delta * table[i + p, j + q] if k < 3 else 0.0
                for twist in range(6):
                    rows[row, twist] += of_x * velocity[twist, k] + of_y * velocity[twist, 6 + k]
                    if k < 3:
                        rows[row, twist] += spread * velocity[twist, 12 + k]
            row += 1
    return rows


@jit("f8[:,:], f8, f8, f8, f8, f8, i8, f8")
def _compute_centred_rows(centred, A, B, C, xg, yg, order, delta):
    """(2, 6) d(xg)/dt and d(yg)/dt, and the rows of `_compute_rows` of the centred moments (n, n).
    """
    velocity = image_velocity(A, B, C, xg, yg)
    # About the centre of gravity mu10 = mu01 = 0, so L_xg = L_m10 / m00 without a quotient rule.
    first, centre = _compute_rows(centred, velocity, 1, delta), np.empty((2, 6))
    for i in range(6):
        for k in range(2):
            centre[k, i] = first[1 + k, i] / centred[0, 0]
            # Its velocity is taken off the constant terms of x' and y'.
            velocity[i, 6 * k] -= centre[k, i]
    rows = _compute_rows(centred, velocity, order, delta)
    for i in range(6):
        rows[1, i] = rows[2, i] = 0.0
    return centre, rows
