"""Interaction matrices of image moments and image points.

    d(m_ij)/dt = L (vx, vy, vz, wx, wy, wz)

where (vx, ..., wz) is the twist of the camera in its own optical frame. When the camera moves, the
image (x, y) of a point on the plane 1/Z = A x + B y + C has the velocity

    x' = -vx/Z + x vz/Z + x y wx - (1 + x^2) wy + y wz
    y' = -vy/Z + y vz/Z + (1 + y^2) wx - x y wy - x wz,

For each component of the twist, this velocity is a polynomial of degree two in x and y, and hence
in a = x - x0 and b = y - y0 for any origin (x0, y0). The derivative of a moment about this origin
is

    d(m_ij)/dt = integral of (i a^(i-1) b^j x' + j a^i b^(j-1) y' + delta a^i b^j div(x', y')).

It is a linear combination of moments up to order i + j + 1. delta is 1 for a region, whose area
changes with the velocity field, and 0 for a set of points. Raw moments have the origin (0, 0). For
centred moments, the origin is the centre of gravity, whose velocity is subtracted from x' and y'.

Reference: F. Chaumette, Image moments: a general and useful set of features for visual
servoing, IEEE Transactions on Robotics 20(4), 2004. It contains the same interaction matrices,
written out term by term.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from aras_visual_servo_base.compiled import jit

from .errors import UnavailableFeatureError
from .moments import DENSE, Moments
from .polygons import Array

# Exponents (p, q) of the monomials a^p b^q: 1, a, b, a^2, ab, b^2.
_MONOMIALS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))


class Plane(NamedTuple):
    """Plane of the target in the camera's optical frame, 1/Z = A x + B y + C; A, B, C in 1/m."""

    A: float
    B: float
    C: float

    @classmethod
    def fronto_parallel(cls, Z: float) -> Plane:
        """Return the plane at depth Z (m) parallel to the image plane."""
        if not Z > 0.0:
            raise UnavailableFeatureError(
                f"the depth of the target's plane must be positive, got {Z:g} m"
            )
        return cls(0.0, 0.0, 1.0 / Z)

    @classmethod
    def from_pose(cls, R: ArrayLike, t: ArrayLike) -> Plane:
        """Return the plane z = 0 of an object's frame.

        R (3, 3) and t (3,), in m, are the orientation and the origin of this frame in the camera's
        optical frame.
        """
        normal = np.asarray(R, dtype=float)[:, 2]
        distance = float(normal @ np.asarray(t, dtype=float))
        if distance == 0.0:
            raise UnavailableFeatureError(
                "the camera is in the target's plane and sees it edge-on; move the camera out of "
                "this plane"
            )
        A, B, C = normal / distance
        return cls(float(A), float(B), float(C))

    def inverse_depth(self, x: float, y: float) -> float:
        """Return 1/Z, in 1/m, of the point on the plane whose image is (x, y)."""
        return self.A * x + self.B * y + self.C


@jit("f8[:], f8, f8[:,:]", allocates=False)
def transform_plane(normal, offset, world_T_camera):
    """Transform the plane normal . X = offset, in m, from the world to the camera's optical frame.

    Returns:
        The signed distance of the camera from the plane, times |normal|; A, B and C of the plane,
        which are not finite if this distance is 0.
    """
    x, y, z = normal
    T = world_T_camera
    height = offset - (x * T[0, 3] + y * T[1, 3] + z * T[2, 3])
    x, y, z = x / height, y / height, z / height
    return (
        height, x * T[0, 0] + y * T[1, 0] + z * T[2, 0], x * T[0, 1] + y * T[1, 1] + z * T[2, 1],
        x * T[0, 2] + y * T[1, 2] + z * T[2, 2],
    )  # fmt: skip


def point_interaction(points: np.ndarray, inverse_depth: np.ndarray) -> np.ndarray:
    """Return the interaction matrix L of image points (x, y): d(x, y)/dt = L v.

    v is the twist of the camera in its own optical frame. This module's docstring contains the
    equations of x' and y'.

    Args:
        points: (n, 2) normalised coordinates x = X/Z, y = Y/Z.
        inverse_depth: (n,) 1/Z of each point, 1/m, where Z is its depth along the optical axis.

    Returns:
        (2n, 6) with the rows of x_0, y_0, x_1, ...

    Raises:
        UnavailableFeatureError: the points do not have the shape (n, 2).
    """
    points, inverse_depth = np.asarray(points, float), np.asarray(inverse_depth, float)
    if points.ndim != 2 or points.shape[1] != 2:
        raise UnavailableFeatureError(
            f"the points have the shape {points.shape}, must have the shape (n, 2)"
        )
    if inverse_depth.shape != (len(points),):
        inverse_depth = np.broadcast_to(inverse_depth, len(points))
    L = np.zeros((2 * len(points), 6))
    _write_point_interaction(points, inverse_depth, L)
    return L


@jit("f8[:,:], f8, f8, f8, f8[:,::1]")
def write_plane_point_interaction(points, A, B, C, L):
    """Write L (2n, 6), the interaction matrix of points (n, 2) on the plane 1/Z = A x + B y + C.

    Return whether all points are in front of the camera.
    """
    inverse_depth, in_front = np.empty(len(points)), True
    for k in range(len(points)):
        inverse_depth[k] = A * points[k, 0] + B * points[k, 1] + C
        in_front &= inverse_depth[k] > 0.0
        for i in range(6):
            L[2 * k, i] = L[2 * k + 1, i] = 0.0
    _write_point_interaction(points, inverse_depth, L)
    return in_front


@jit("f8[:,:], f8[:], f8[:,::1]", allocates=False)
def _write_point_interaction(points, inverse_depth, L):
    """Write the interaction matrix of points (n, 2) into L (2n, 6), which must contain only zeros.
    """
    for k in range(len(points)):
        x, y, w = points[k, 0], points[k, 1], inverse_depth[k]
        L[2 * k, 0] = L[2 * k + 1, 1] = -w
        L[2 * k, 2], L[2 * k + 1, 2] = x * w, y * w
        L[2 * k, 3], L[2 * k + 1, 3] = x * y, 1.0 + y * y
        L[2 * k, 4], L[2 * k + 1, 4] = -1.0 - x * x, -x * y
        L[2 * k, 5], L[2 * k + 1, 5] = y, -x


@jit("f8, f8, f8, f8, f8")
def image_velocity(A, B, C, x0, y0):
    """Compute the velocity (x', y') of image points of the plane 1/Z = A x + B y + C.

    The velocity is a polynomial in a = x - x0 and b = y - y0.

    Returns:
        (6, 15) coefficients, one row for each component of the camera's twist. Columns 0-5 are the
        coefficients of 1, a, b, a^2, ab, b^2 in x'. Columns 6-11 are those in y'. Columns 12-14 are
        the coefficients of 1, a, b in the divergence of (x', y').
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
    """Compute the interaction matrix L of all raw moments m_ij with i + j <= order.

    Args:
        moments: moments of the current view.
        plane: the target's plane in the camera's optical frame.
        order: highest i + j, at most moments.order - 1, which is the default.

    Returns:
        ((order+1)(order+2)/2, 6), one row for each m_ij, sorted by i + j, then j.
    """
    order = _find_order(moments, order)
    return _compute_rows(
        moments.raw, image_velocity(*plane, 0.0, 0.0), order, 1.0 if moments.kind == DENSE else 0.0
    )


def compute_centred_interaction(
    moments: Moments, plane: Plane, order: int | None = None
) -> Array:
    """Compute the interaction matrix of the centre of gravity and of the centred moments.

    The arguments are those of `compute_raw_interaction`.

    Returns:
        The matrix (2 + (order+1)(order+2)/2, 6) of xg, yg, and all mu_ij with i + j <= order. The
        rows of mu10 and mu01 are 0.
    """
    order = _find_order(moments, order)
    return compute_centred_rows(
        moments.centred, *plane, moments.xg, moments.yg, order,
        1.0 if moments.kind == DENSE else 0.0,
    )  # fmt: skip


def _find_order(moments: Moments, order: int | None) -> int:
    highest = moments.order - 1
    if order is None:
        order = highest
    if not 1 <= order <= highest:
        raise UnavailableFeatureError(
            f"the interaction matrices of moments of order {order} need moments up to order "
            f"{order + 1}, got order {moments.order}; increase the order of the moments"
        )
    return order


@jit("f8[:,:], f8[:,:], i8, f8")
def _compute_rows(table, velocity, order, delta):
    """Compute the interaction matrix of the moments m_ij with i + j <= order about an origin.

    Args:
        table: (n, n) moments about this origin, m_ij at [i, j].
        velocity: (6, 15) result of `image_velocity` for this origin.
        order: highest i + j.
        delta: 1 for a region, 0 for a set of points.

    Returns:
        ((order+1)(order+2)/2, 6), one row for each m_ij, sorted by i + j, then j.
    """
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
def compute_centred_rows(centred, A, B, C, xg, yg, order, delta):
    """Compute the interaction matrix of the centre of gravity and of the centred moments.

    Args:
        centred: (n, n) centred moments mu_ij at [i, j].
        A, B, C: the target's plane, 1/Z = A x + B y + C.
        xg, yg: centre of gravity, normalised.
        order: highest i + j.
        delta: 1 for a region, 0 for a set of points.

    Returns:
        ((order+1)(order+2)/2 + 2, 6), the rows of xg and yg, followed by those of all mu_ij with
        i + j <= order, sorted by i + j, then j.
    """
    velocity = image_velocity(A, B, C, xg, yg)
    # About the centre of gravity, m10 = m01 = 0, so the interaction row of xg is that of m10
    # divided by m00.
    first_rows = _compute_rows(centred, velocity, 1, delta)
    for i in range(6):
        for k in range(2):
            first_rows[1 + k, i] /= centred[0, 0]
            # Subtract the velocity of the centre of gravity from the constant terms of x' and y'.
            velocity[i, 6 * k] -= first_rows[1 + k, i]
    rows = _compute_rows(centred, velocity, order, delta)
    both = np.empty((2 + len(rows), 6))
    for i in range(6):
        both[0, i], both[1, i] = first_rows[1, i], first_rows[2, i]
        for k in range(len(rows)):
            both[2 + k, i] = 0.0 if k in (1, 2) else rows[k, i]
    return both
