"""Rigid poses: (4, 4) arrays, `a_T_b` maps coordinates of b to a."""

import math
from collections.abc import Sequence

import numpy as np

# Gazebo's camera link looks along +x with z up; the optical frame looks along +z with y down.
LINK_R_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def rotation_rpy(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Rotation matrix (3, 3) of fixed-axis roll, pitch, yaw (rad), as URDF writes them."""
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


def transform(xyz: Sequence[float], rpy: Sequence[float]) -> np.ndarray:
    """Pose (4, 4) of a URDF `<origin>`: xyz in m, fixed-axis roll, pitch, yaw in rad."""
    a_T_b = np.eye(4)
    a_T_b[:3, :3] = rotation_rpy(*rpy)
    a_T_b[:3, 3] = xyz
    return a_T_b


def inverse(a_T_b: np.ndarray) -> np.ndarray:
    """`b_T_a` (4, 4) of a rigid pose."""
    b_T_a = np.eye(4)
    b_T_a[:3, :3] = a_T_b[:3, :3].T
    b_T_a[:3, 3] = -a_T_b[:3, :3].T @ a_T_b[:3, 3]
    return b_T_a


def optical(a_T_link: np.ndarray) -> np.ndarray:
    """`a_T_optical` (4, 4) of a camera that looks along its link's +x, z up, as Gazebo's do."""
    a_T_optical = np.array(a_T_link, float)
    a_T_optical[:3, :3] = a_T_link[:3, :3] @ LINK_R_OPTICAL
    return a_T_optical


def pose_difference(a_T_b: np.ndarray, a_T_c: np.ndarray) -> tuple[float, float]:
    """Distance (m) and rotation angle (rad) between two poses (4, 4) in one frame."""
    distance = float(np.linalg.norm(a_T_b[:3, 3] - a_T_c[:3, 3]))
    return distance, float(np.linalg.norm(rotation_vector(a_T_b[:3, :3].T @ a_T_c[:3, :3])))


def rotation_vector(R: np.ndarray) -> np.ndarray:
    """Axis times angle (3,), rad, of a rotation matrix (3, 3); the angle in [0, pi]."""
    # The antisymmetric part keeps its precision where arccos of the trace loses it.
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = R.tolist()
    x, y, z = zy - yz, xz - zx, yx - xy
    sine, cosine = 0.5 * math.hypot(x, y, z), 0.5 * (xx + yy + zz - 1.0)
    angle = math.atan2(sine, cosine)
    if sine > 1e-6 or cosine > 0.0:
        factor = 0.5 * angle / sine if sine > 1e-6 else 0.5
        return np.array([factor * x, factor * y, factor * z])
    # Half a turn: the axis is the column of (R + 1) / 2 that is longest.
    half = 0.25 * (R + R.T) + 0.5 * np.eye(3)
    axis = half[:, int(np.argmax(np.diag(half)))]
    if axis @ (x, y, z) < 0.0:
        axis = -axis
    return angle * axis / np.linalg.norm(axis)


def body_motion(before_T_after: np.ndarray) -> np.ndarray:
    """Twist (6,) that gives a small motion (4, 4) in one unit of time: its logarithm."""
    a, b, c = rotation_vector(before_T_after[:3, :3]).tolist()
    x, y, z = before_T_after[:3, 3].tolist()
    along, square = a * x + b * y + c * z, a * a + b * b + c * c
    # p - w x p / 2 + w x (w x p) / 12
    return np.array([
        x - 0.5 * (b * z - c * y) + (a * along - x * square) / 12.0,
        y - 0.5 * (c * x - a * z) + (b * along - y * square) / 12.0,
        z - 0.5 * (a * y - b * x) + (c * along - z * square) / 12.0,
        a, b, c,
    ])  # fmt: skip
