"""Interpolation between the poses of bodies at two instants, in compiled code."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_base.compiled import jit
from aras_visual_servo_base.poses import quaternion_from_matrix


@jit("f8[:,::1], f8[:,::1], f8[:,::1], f8[:,::1], f8, f8[:,:,::1]")
def blend_poses(before_p, before_q, p, q, blend, out):
    """Interpolate between N pairs of poses; write homogeneous matrices to `out` (N, 4, 4).

    The first poses have the positions `before_p` (N, 3) and the unit quaternions `before_q` (N, 4),
    ordered xyzw; the second poses have `p` and `q`. `blend` is 0 at the first poses and 1 at the
    second. Quaternions are interpolated linearly and normalised; over one physics step, the error
    is of third order in the angle of rotation.
    """
    turn = np.empty(4)
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
            T[k, 3], T[3, k] = before_p[n, k] + blend * (p[n, k] - before_p[n, k]), 0.0
        T[3, 3] = 1.0


def blend_pose(before: np.ndarray, now: np.ndarray, blend: float) -> np.ndarray:
    """Interpolate between two poses (4, 4); `blend` is 0 at `before` and 1 at `now`."""
    p, q = np.array((before[None, :3, 3], now[None, :3, 3])), np.empty((2, 1, 4))
    pose = np.empty((1, 4, 4))
    q[0], q[1] = quaternion_from_matrix(before[:3, :3].tolist()), quaternion_from_matrix(
        now[:3, :3].tolist()
    )
    blend_poses(p[0], q[0], p[1], q[1], blend, pose)
    return pose[0]
