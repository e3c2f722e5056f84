"""Rotations, rigid poses and twists.

`a_T_b` maps coordinates in b to a, and `a_R_b` maps directions. Lengths are in m, angles in rad.
Quaternions are (x, y, z, w) with unit length. Poses have two representations: the class `Pose`,
which contains tuples of floats, and NumPy arrays (4, 4). `Pose` is faster for single poses in a
fast loop. Arrays are for products with Jacobians and points. The functions before LINK_R_OPTICAL
use tuples, those after it use arrays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
_EYE = np.eye(4)
LENGTH_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}  # length of each unit in m


class Twist(NamedTuple):
    """Twist of a frame in world axes: velocity of its origin (m/s), angular velocity (rad/s)."""

    linear: Vector3 = (0.0, 0.0, 0.0)
    angular: Vector3 = (0.0, 0.0, 0.0)


class Pose(NamedTuple):
    """A rigid pose: position (x, y, z) in m, and unit quaternion (x, y, z, w).

    A pose a_T_b maps coordinates in b to a. `@` composes poses; `matrix` returns the (4, 4) matrix.
    """

    xyz: Vector3 = (0.0, 0.0, 0.0)
    quat: Quaternion = (0.0, 0.0, 0.0, 1.0)

    @classmethod
    def from_rpy(cls, xyz: Vector3, rpy: Vector3) -> Pose:
        """Create a pose from URDF's fixed-axis roll, pitch, yaw (rad)."""
        return cls(tuple(xyz), quaternion_from_rpy(*rpy))

    @classmethod
    def from_matrix(cls, a_T_b: np.ndarray) -> Pose:
        """Create a pose from a rigid transform (4, 4)."""
        x, y, z = a_T_b[:3, 3].tolist()
        return cls((x, y, z), quaternion_from_matrix(a_T_b[:3, :3].tolist()))

    @property
    def rpy(self) -> Vector3:
        """The orientation as URDF's fixed-axis roll, pitch, yaw (rad)."""
        return rpy_from_rotation(rotation_from_quaternion(self.quat))

    def __matmul__(self, other: Pose) -> Pose:
        """Return the composed pose a_T_c = a_T_b @ b_T_c."""
        moved = rotate(self.quat, other.xyz)
        return Pose(add(self.xyz, moved), normalise(multiply(self.quat, other.quat)))

    def inverse(self) -> Pose:
        """Return the inverse pose b_T_a of a_T_b."""
        back = conjugate(self.quat)
        return Pose(scale(rotate(back, self.xyz), -1.0), back)

    def apply(self, point: Vector3) -> Vector3:
        """Return the coordinates in frame a of a point that is given in frame b, for a pose a_T_b.
        """
        return add(self.xyz, rotate(self.quat, point))

    def matrix(self) -> np.ndarray:
        """Return the homogeneous matrix (4, 4)."""
        first, second, third = rotation_from_quaternion(self.quat)
        x, y, z = self.xyz
        rows = (*first, x, *second, y, *third, z, 0.0, 0.0, 0.0, 1.0)
        return np.array(rows).reshape(4, 4)


IDENTITY = Pose()


def add(a: Vector3, b: Vector3) -> Vector3:
    """Return a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def subtract(a: Vector3, b: Vector3) -> Vector3:
    """Return a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scale(a: Vector3, factor: float) -> Vector3:
    """Return factor * a."""
    return (a[0] * factor, a[1] * factor, a[2] * factor)


def cross(a: Vector3, b: Vector3) -> Vector3:
    """Return the cross product a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def conjugate(q: Quaternion) -> Quaternion:
    """Return the inverse of a unit quaternion."""
    return (-q[0], -q[1], -q[2], q[3])


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the Hamilton product a b, which rotates by b first and then by a."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def rotate(q: Quaternion, v: Vector3) -> Vector3:
    """Return `v` rotated by the unit quaternion `q`."""
    x, y, z, w = q
    tx = 2.0 * (y * v[2] - z * v[1])
    ty = 2.0 * (z * v[0] - x * v[2])
    tz = 2.0 * (x * v[1] - y * v[0])
    return (
        v[0] + w * tx + y * tz - z * ty,
        v[1] + w * ty + z * tx - x * tz,
        v[2] + w * tz + x * ty - y * tx,
    )


def normalise(q: Quaternion) -> Quaternion:
    """Return the quaternion `q` scaled to unit length; an exact unit quaternion is not changed."""
    norm = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    if norm == 1.0:
        return q
    return (q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm)


def quaternion_from_rpy(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Return the quaternion of the rotation Rz(yaw) Ry(pitch) Rx(roll); the angles are in rad."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def quaternion_from_z_to(direction: Vector3) -> Quaternion:
    """Return the quaternion of the shortest rotation from the z axis to a unit vector."""
    x, y, z = direction
    return normalise((-y, x, 0.0, 1.0 + z)) if z > -1.0 else (1.0, 0.0, 0.0, 0.0)


def quaternion_from_matrix(rotation: Sequence[Sequence[float]]) -> Quaternion:
    """Return the unit quaternion of a rotation matrix (3, 3), by Shepperd's method (1978)."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.asarray(rotation, float).tolist()
    squares = (1.0 + xx - yy - zz, 1.0 - xx + yy - zz, 1.0 - xx - yy + zz, 1.0 + xx + yy + zz)
    rows = (
        (squares[0], xy + yx, xz + zx, zy - yz),
        (xy + yx, squares[1], yz + zy, xz - zx),
        (xz + zx, yz + zy, squares[2], yx - xy),
        (zy - yz, xz - zx, yx - xy, squares[3]),
    )
    return normalise(rows[squares.index(max(squares))])


def rotation_from_quaternion(q: Quaternion) -> tuple[Vector3, Vector3, Vector3]:
    """Return the rows of the rotation matrix (3, 3) of a unit quaternion."""
    x, y, z, w = q
    a, b, c = 2.0 * x, 2.0 * y, 2.0 * z
    return (
        (1.0 - y * b - z * c, y * a - w * c, w * b + z * a),
        (w * c + x * b, 1.0 - z * c - x * a, z * b - w * a),
        (x * c - w * b, w * a + y * c, 1.0 - x * a - y * b),
    )


def rpy_from_rotation(R: Sequence[Sequence[float]]) -> Vector3:
    """Return fixed-axis roll, pitch, yaw (rad) of a rotation (3, 3).

    If the pitch is ±90°, roll and yaw are not unique; then the roll is 0.
    """
    (xx, xy, _), (yx, yy, _), (zx, zy, zz) = ([float(v) for v in row] for row in R)
    across = math.hypot(xx, yx)
    pitch = math.atan2(-zx, across)
    if across > 1e-9:
        return math.atan2(zy, zz), pitch, math.atan2(yx, xx)
    return 0.0, pitch, math.atan2(-xy, yy)  # roll and yaw have the same axis, so roll is set to 0


# Rotation of the optical frame (z forward, y down) in Gazebo's camera link (x forward, z up).
LINK_R_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
LINK_R_OPTICAL.setflags(write=False)


def rotation_from_rpy(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Return the rotation matrix (3, 3) of URDF's fixed-axis roll, pitch, yaw (rad)."""
    cr, sr = np.cos(roll), np.sin(roll)
    cp, sp = np.cos(pitch), np.sin(pitch)
    cy, sy = np.cos(yaw), np.sin(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def matrix_from_xyz_rpy(xyz: Sequence[float], rpy: Sequence[float]) -> np.ndarray:
    """Return the pose (4, 4) of a URDF <origin>: xyz (m) and fixed-axis roll, pitch, yaw (rad)."""
    a_T_b = np.eye(4)
    a_T_b[:3, :3] = rotation_from_rpy(*rpy)
    a_T_b[:3, 3] = xyz
    return a_T_b


def inverse(a_T_b: np.ndarray) -> np.ndarray:
    """Return the inverse `b_T_a` (4, 4) of a rigid pose."""
    b_T_a = _EYE.copy()
    b_T_a[:3, :3] = a_T_b[:3, :3].T
    b_T_a[:3, 3] = -a_T_b[:3, :3].T @ a_T_b[:3, 3]
    return b_T_a


def relative_pose(a_T_b: np.ndarray, a_T_c: np.ndarray) -> np.ndarray:
    """Return the relative pose `b_T_c` (4, 4) of two rigid poses."""
    b_R_a = a_T_b[:3, :3].T
    b_T_c = _EYE.copy()
    b_T_c[:3, :3] = b_R_a @ a_T_c[:3, :3]
    b_T_c[:3, 3] = b_R_a @ (a_T_c[:3, 3] - a_T_b[:3, 3])
    return b_T_c


def xyz_rpy_from_matrix(a_T_b: np.ndarray) -> tuple[list[float], list[float]]:
    """Return URDF's xyz (m) and fixed-axis roll, pitch, yaw (rad) of a pose (4, 4)."""
    return a_T_b[:3, 3].tolist(), list(rpy_from_rotation(a_T_b[:3, :3]))


def optical_pose(a_T_link: np.ndarray) -> np.ndarray:
    """Return the pose a_T_optical (4, 4) of the optical frame of a camera link, as in Gazebo.

        a_T_link (4, 4) is the pose of the camera link, in which x is forward and z is up.
    """
    a_T_optical = np.array(a_T_link, float)
    a_T_optical[:3, :3] = a_T_link[:3, :3] @ LINK_R_OPTICAL
    return a_T_optical


def pose_difference(a_T_b: np.ndarray, a_T_c: np.ndarray) -> tuple[float, float]:
    """Return the distance (m) and the rotation angle (rad) between two poses (4, 4)."""
    offset = a_T_b[:3, 3] - a_T_c[:3, 3]
    rotation = rotation_vector(a_T_b[:3, :3].T @ a_T_c[:3, :3])
    return math.sqrt(offset.dot(offset)), math.sqrt(rotation.dot(rotation))


def rotation_vector(R: np.ndarray) -> np.ndarray:
    """Return the rotation vector (3,) of a rotation matrix (3, 3), rad; its norm is in [0, pi]."""
    rows = R.tolist()
    return np.array(compute_logarithm(*rows[0], 0.0, *rows[1], 0.0, *rows[2], 0.0)[3:])


def rotation_vector_rate(rotation: np.ndarray) -> np.ndarray:
    """Return the matrix J (3, 3) that maps angular velocity to the rate of a rotation vector.

    `rotation` is the rotation vector of a_R_b. Let omega (rad/s) be the angular velocity of b
    relative to a. The rate of the rotation vector is J @ omega if omega is in the axes of b, and
    J.T @ omega if omega is in the axes of a. J is the inverse right Jacobian of SO(3).
    """
    K, angle = skew(rotation), float(np.linalg.norm(rotation))
    factor = 1.0 / 12.0
    if angle > 1e-4:
        factor = (1.0 - 0.5 * angle / math.tan(0.5 * angle)) / angle**2
    return np.eye(3) + 0.5 * K + factor * K @ K


def skew(v: Sequence[float]) -> np.ndarray:
    """Return the matrix [v]x (3, 3) with skew(v) @ w = v x w."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def adjoint(a_T_b: np.ndarray) -> np.ndarray:
    """Return the matrix (6, 6) that maps twists of a rigid body from frame b to frame a.

    Both frames are fixed to the body. The matrix maps the twist of b, in the axes of b, to that of
    a, in the axes of a.
    """
    turned = np.zeros((6, 6))
    turned[:3, :3] = turned[3:, 3:] = a_T_b[:3, :3]
    turned[:3, 3:] = skew(a_T_b[:3, 3]) @ a_T_b[:3, :3]
    return turned


def exponential(twist: Sequence[float]) -> np.ndarray:
    """Return the pose a_T_b (4, 4) of b after it has moved from a with a twist for one second.

    `twist` (6,) is the constant twist of b in the axes of b.
    """
    rows = compute_exponential(*np.asarray(twist, float).tolist())
    return np.array((*rows, 0.0, 0.0, 0.0, 1.0)).reshape(4, 4)


def compute_exponential(
    vx: float, vy: float, vz: float, x: float, y: float, z: float
) -> tuple[float, ...]:
    """Return the first three rows (12,) of `exponential`; compiled functions use it, too."""
    square = x * x + y * y + z * z
    angle = math.sqrt(square)
    if angle > 1e-8:
        first = math.sin(angle) / angle
        second = 0.5 * (math.sin(0.5 * angle) / (0.5 * angle)) ** 2  # (1 - cos(angle)) / angle^2
        third = (1.0 - first) / square
    else:
        first, second, third = 1.0, 0.5, 1.0 / 6.0
    along = third * (x * vx + y * vy + z * vz)
    return (
        1.0 - second * (y * y + z * z), second * x * y - first * z, second * x * z + first * y,
        first * vx + second * (y * vz - z * vy) + along * x,
        second * x * y + first * z, 1.0 - second * (x * x + z * z), second * y * z - first * x,
        first * vy + second * (z * vx - x * vz) + along * y,
        second * x * z - first * y, second * y * z + first * x, 1.0 - second * (x * x + y * y),
        first * vz + second * (x * vy - y * vx) + along * z,
    )  # fmt: skip


def logarithm(a_T_b: np.ndarray) -> np.ndarray:
    """Return the constant twist (6,) that moves b from a to the pose a_T_b in one second.

    It is the inverse of `exponential` for rotations up to pi.
    """
    return np.array(compute_logarithm(*a_T_b[:3].ravel().tolist()))


def compute_logarithm(
    xx: float, xy: float, xz: float, x: float,
    yx: float, yy: float, yz: float, y: float,
    zx: float, zy: float, zz: float, z: float,
) -> tuple[float, ...]:
    """Return `logarithm` (6,) of a pose's first three rows; compiled functions use it, too."""
    # Use the antisymmetric part of the rotation R, because arccos of the trace of R is inaccurate
    # for small angles.
    a, b, c = zy - yz, xz - zx, yx - xy
    sine, cosine = 0.5 * math.sqrt(a * a + b * b + c * c), 0.5 * (xx + yy + zz - 1.0)
    angle = math.atan2(sine, cosine)
    if sine > 1e-4 or cosine > 0.0:
        factor = 0.5 * angle / sine if sine > 1e-6 else 0.5
        a, b, c = factor * a, factor * b, factor * c
    else:
        # Near half a turn, use the symmetric part of R, which is accurate there: (R + R^T) / 2 -
        # cos(angle) I = (1 - cos(angle)) u u^T, where u is the axis. Every column of this matrix is
        # parallel to u; take the one with the largest diagonal element.
        if xx >= yy and xx >= zz:
            u, v, w = xx - cosine, 0.5 * (xy + yx), 0.5 * (xz + zx)
        elif yy >= zz:
            u, v, w = 0.5 * (xy + yx), yy - cosine, 0.5 * (yz + zy)
        else:
            u, v, w = 0.5 * (xz + zx), 0.5 * (yz + zy), zz - cosine
        factor = angle / math.sqrt(u * u + v * v + w * w)
        if u * a + v * b + w * c < 0.0:
            factor = -factor
        a, b, c = factor * u, factor * v, factor * w
    along, square = a * x + b * y + c * z, a * a + b * b + c * c
    angle = math.sqrt(square)
    # `factor` is (1 - angle/2 cot(angle/2)) / angle^2, which tends to 1/12 for small angles.
    factor = (1.0 - 0.5 * angle / math.tan(0.5 * angle)) / square if angle > 1e-4 else 1.0 / 12.0
    # With w = (a, b, c) and p = (x, y, z), the linear part of the twist is p - w x p / 2 + factor w
    # x (w x p).
    return (
        x - 0.5 * (b * z - c * y) + factor * (a * along - x * square),
        y - 0.5 * (c * x - a * z) + factor * (b * along - y * square),
        z - 0.5 * (a * y - b * x) + factor * (c * along - z * square),
        a, b, c,
    )  # fmt: skip
