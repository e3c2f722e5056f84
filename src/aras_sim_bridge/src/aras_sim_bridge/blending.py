"""Poses between two instants, many at a time and compiled; single ones at an instant: see poses."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import jit
from aras_visual_servo_base.poses import quaternion_from_matrix


@jit("f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8")
def blend_poses(before_p, before_q, p, q, blend):
    """Poses (N, 4, 4) `blend` of the way from one list to another of positions (N, 3) and unit
    quaternions xyzw (N, 4).

    Quaternions are blended linearly and made unit ones again: over one physics step the error is of
    third order in the turned angle.
    """
    out, turn = np.zeros((len(p), 4, 4)), np.empty(4)
    for n in range(len(p)):
        along = square = 0.0
        for k in range(4):
            along += before_q[n, k] * q[n, k]
        for k in range(4):
            turn[k] = (1.0 - blend) * before_q[n, k] + (blend if along >= 0.0 else -blend) * q[n, k]
            square += turn[k] * turn[k]
        size = np.sqrt(square)
        x, y, z, w = turn[0] / size, turn[1] / size, turn[2] / size, turn[3] / size
        T = out[n]
        T[0, 0], T[0, 1] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z)
        T[0, 2], T[1, 0] = 2 * (x * z + w * y), 2 * (x * y + w * z)
        T[1, 1], T[1, 2] = 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
        T[2, 0], T[2, 1] = 2 * (x * z - w * y), 2 * (y * z + w * x)
        T[2, 2] = 1 - 2 * (x * x + y * y)
        for k in range(3):
            T[k, 3] = before_p[n, k] + blend * (p[n, k] - before_p[n, k])
        T[3, 3] = 1.0
    return out


def blend_pose(before: np.ndarray, now: np.ndarray, blend: float) -> np.ndarray:
    """The pose (4, 4) that is `blend` of the way from one to another."""
    one, other = ((T[None, :3, 3].copy(), np.array([quaternion_from_matrix(T[:3, :3].tolist())]))
                  for T in (before, now))
    return blend_poses(*one, *other, blend)[0]
