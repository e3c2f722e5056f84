"""Rigid poses and twists in plain Python floats: single poses in a 1 kHz loop, where NumPy is slow.

`a_T_b` maps coordinates in b to a. Quaternions are (x, y, z, w), unit length.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from aras_sim_bridge.errors import WorldError

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class Twist(NamedTuple):
    """Velocity of a frame: linear (m/s) of its origin, angular (rad/s), in world axes."""

    linear: Vector3 = (0.0, 0.0, 0.0)
    angular: Vector3 = (0.0, 0.0, 0.0)


class Pose(NamedTuple):
    """Position (m) and orientation; unpacks as (xyz, quat)."""

    xyz: Vector3 = (0.0, 0.0, 0.0)
    quat: Quaternion = (0.0, 0.0, 0.0, 1.0)

    @classmethod
    def from_rpy(cls, xyz: Vector3, rpy: Vector3) -> "Pose":
        """Pose from URDF's fixed-axis roll, pitch, yaw (rad)."""
        return cls(tuple(xyz), quaternion_from_rpy(*rpy))

    @property
    def rpy(self) -> Vector3:
        """The orientation as URDF's roll, pitch, yaw, rad."""
        return rpy_from_quaternion(self.quat)

    def __matmul__(self, other: "Pose") -> "Pose":
        """a_T_b @ b_T_c = a_T_c."""
        moved = rotate(self.quat, other.xyz)
        return Pose(add(self.xyz, moved), normalised(multiply(self.quat, other.quat)))

    def inverse(self) -> "Pose":
        """b_T_a of a_T_b."""
        back = conjugate(self.quat)
        return Pose(scaled(rotate(back, self.xyz), -1.0), back)

    def apply(self, point: Vector3) -> Vector3:
        """`point` of b in a."""
        return add(self.xyz, rotate(self.quat, point))

    def matrix(self) -> list[list[float]]:
        """Homogeneous (4, 4) matrix as nested lists."""
        columns = [rotate(self.quat, axis) for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]
        rows = [[columns[c][r] for c in range(3)] + [self.xyz[r]] for r in range(3)]
        return [*rows, [0.0, 0.0, 0.0, 1.0]]


IDENTITY = Pose()


def add(a: Vector3, b: Vector3) -> Vector3:
    """a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def subtract(a: Vector3, b: Vector3) -> Vector3:
    """a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scaled(a: Vector3, factor: float) -> Vector3:
    """factor * a."""
    return (a[0] * factor, a[1] * factor, a[2] * factor)


def cross(a: Vector3, b: Vector3) -> Vector3:
    """a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def conjugate(q: Quaternion) -> Quaternion:
    """Inverse of a unit quaternion."""
    return (-q[0], -q[1], -q[2], q[3])


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton product a b: first b, then a."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def rotate(q: Quaternion, v: Vector3) -> Vector3:
    """`v` turned by the unit quaternion `q`."""
    x, y, z, w = q
    tx = 2.0 * (y * v[2] - z * v[1])
    ty = 2.0 * (z * v[0] - x * v[2])
    tz = 2.0 * (x * v[1] - y * v[0])
    return (
        v[0] + w * tx + y * tz - z * ty,
        v[1] + w * ty + z * tx - x * tz,
        v[2] + w * tz + x * ty - y * tx,
    )


def normalised(q: Quaternion) -> Quaternion:
    """`q` at unit length; exactly unit quaternions are returned unchanged."""
    norm = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    if norm == 1.0:
        return q
    return (q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm)


def quaternion_from_rpy(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Rz(yaw) Ry(pitch) Rx(roll)."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def quaternion_to(direction: Vector3) -> Quaternion:
    """Turns z onto a unit vector, the shortest way."""
    x, y, z = direction
    return normalised((-y, x, 0.0, 1.0 + z)) if z > -1.0 else (1.0, 0.0, 0.0, 0.0)


def quaternion_from_matrix(rotation: Sequence[Sequence[float]]) -> Quaternion:
    """Unit quaternion of a (3, 3) rotation, from its largest component (Shepperd 1978)."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = ([float(v) for v in row] for row in rotation)
    squares = (1.0 + xx - yy - zz, 1.0 - xx + yy - zz, 1.0 - xx - yy + zz, 1.0 + xx + yy + zz)
    rows = (
        (squares[0], xy + yx, xz + zx, zy - yz),
        (xy + yx, squares[1], yz + zy, xz - zx),
        (xz + zx, yz + zy, squares[2], yx - xy),
        (zy - yz, xz - zx, yx - xy, squares[3]),
    )
    return normalised(rows[squares.index(max(squares))])


def rpy_from_quaternion(quat: Quaternion) -> Vector3:
    """Fixed-axis roll, pitch, yaw of a unit quaternion, the inverse of `quaternion_from_rpy`."""
    x, y, z, w = quat
    sine = max(-1.0, min(1.0, 2.0 * (w * y - z * x)))
    pitch = math.asin(sine)
    if abs(sine) > 1.0 - 1e-12:
        return 0.0, pitch, -2.0 * math.copysign(1.0, sine) * math.atan2(x, w)
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return roll, pitch, yaw


def checked_vector(values: object, what: str, count: int = 3) -> tuple[float, ...]:
    """`count` finite floats as a tuple; WorldError naming `what` otherwise."""
    try:
        result = tuple(float(v) for v in values)
    except (TypeError, ValueError):
        raise WorldError(f"{what}: {values!r} is not a sequence of {count} numbers") from None
    if len(result) != count:
        raise WorldError(f"{what}: needs {count} numbers, got {len(result)}")
    if not math.isfinite(sum(abs(v) for v in result)):
        raise WorldError(f"{what}: {result} holds a number that is not finite")
    return result


def checked_pose(pose: object, what: str, zero_is_identity: bool = False) -> Pose:
    """A finite pose with its quaternion normalised.

    Args:
        pose: (xyz, quat).
        what: whose pose, for the message.
        zero_is_identity: whether (0, 0, 0, 0) means no rotation, as an unset message field does.

    Raises:
        WorldError: not finite, wrong length, or a quaternion far from unit length.
    """
    try:
        xyz, quat = pose
    except (TypeError, ValueError):
        raise WorldError(f"{what}: {pose!r} is not (position, quaternion)") from None
    xyz = checked_vector(xyz, f"{what}: position")
    quat = checked_vector(quat, f"{what}: orientation", 4)
    norm = math.hypot(*quat)
    if zero_is_identity and norm == 0.0:
        return Pose(xyz)
    if not 1e-6 <= norm <= 1e6:
        raise WorldError(f"{what}: orientation {quat} is no unit quaternion; use (0, 0, 0, 1) for "
                         "none")
    return Pose(xyz, normalised(quat))
