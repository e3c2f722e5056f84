"""Poses between two instants, many at a time and compiled; single ones at an instant: see poses."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import compiled
from aras_visual_servo_base.poses import quaternion_from_matrix


@compiled("f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8")
def blended_poses(before_p, before_q, p, q, blend):
    """Poses (N, 4, 4) `blend` of the way from one list to another of positions (N, 3) and unit
    quaternions xyzw (N, 4).

    Quaternions are blended linearly and made unit ones again: over one physics step the error is of
    third order in the turned angle.
    """
    out = np.zeros((len(p), 4, 4))
    for n in range(len(p)):
        same = (before_q[n] * q[n]).sum() >= 0.0
        turn = (1.0 - blend) * before_q[n] + (blend if same else -blend) * q[n]
        x, y, z, w = turn / np.sqrt((turn * turn).sum())
        T = out[n]
        T[0, :3] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
        T[1, :3] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
        T[2, :3] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
        T[:3, 3] = before_p[n] + blend * (p[n] - before_p[n])
        T[3, 3] = 1.0
    return out


def blended(before: np.ndarray, now: np.ndarray, blend: float) -> np.ndarray:
    """The pose (4, 4) that is `blend` of the way from one to another."""
    one, other = ((T[None, :3, 3].copy(), np.array([quaternion_from_matrix(T[:3, :3].tolist())]))
                  for T in (before, now))
    return blended_poses(*one, *other, blend)[0]
