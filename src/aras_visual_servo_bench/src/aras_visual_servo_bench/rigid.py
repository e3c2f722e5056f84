"""Rigid motions (4, 4) and the twists that make them.

A twist is (vx, vy, vz, wx, wy, wz), m/s and rad/s, of a frame in itself.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio


def exponential(twist: Sequence[float]) -> np.ndarray:
    """a_T_b (4, 4) after one second of a constant twist (6,) of b."""
    return pinocchio.exp6(np.asarray(twist, float)).homogeneous


def logarithm(a_T_b: np.ndarray) -> np.ndarray:
    """The twist (6,) that makes this motion in one second; rotations up to pi."""
    return pinocchio.log6(np.asarray(a_T_b, float)).vector


def right_jacobian(twist: Sequence[float]) -> np.ndarray:
    """(6, 6): the twist of exponential(q(t)) in its own frame is right_jacobian(q) q_dot."""
    return pinocchio.Jexp6(np.asarray(twist, float))


def to_xyz_rpy(a_T_b: np.ndarray) -> tuple[list[float], list[float]]:
    """Place (m) and fixed-axis roll, pitch, yaw (rad) of a pose (4, 4), as URDF has them."""
    rpy = pinocchio.rpy.matrixToRpy(np.array(a_T_b[:3, :3]))
    return [float(v) for v in a_T_b[:3, 3]], [float(v) for v in rpy]
