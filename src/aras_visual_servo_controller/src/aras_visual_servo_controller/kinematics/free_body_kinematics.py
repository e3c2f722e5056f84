"""Compiled pose and Jacobian of a camera that six coordinates move freely.

The coordinates q (6,) are the logarithm of the pose of a body relative to an origin. The camera is
fixed to the body.
"""

import numpy as np

from aras_visual_servo_base import poses
from aras_visual_servo_base.compiled import jit, jit_inline

compute_exponential = jit_inline(poses.compute_exponential)
compute_logarithm = jit_inline(poses.compute_logarithm)


@jit("f8[:,:], f8[:,:], f8[:], f8[:,::1], f8[:,::1]")
def compute_free_pose_and_jacobian(origin, mounting, q, pose, jacobian):
    """Write world_T_camera (4, 4) and its Jacobian (6, 6) into `pose` and `jacobian`.

    Args:
        origin: world_T_body (4, 4) at q = 0.
        mounting: body_T_camera (4, 4).
        q: (6,) coordinates.
        pose, jacobian: outputs. `jacobian @ q_dot` is the twist of the camera in its own frame.
    """
    motion = compute_exponential(q[0], q[1], q[2], q[3], q[4], q[5])
    body = np.empty((3, 4))
    for i in range(3):
        for j in range(4):
            total = origin[i, 3] if j == 3 else 0.0
            for k in range(3):
                total += origin[i, k] * motion[4 * k + j]
            body[i, j] = total
    for i in range(3):
        for j in range(4):
            total = body[i, 3] if j == 3 else 0.0
            for k in range(3):
                total += body[i, k] * mounting[k, j]
            pose[i, j] = total
        pose[3, i] = 0.0
    pose[3, 3] = 1.0
    rates = _compute_right_jacobian(q)
    x, y, z = mounting[0, 3], mounting[1, 3], mounting[2, 3]
    # Velocity of the camera's origin for a unit rate of the coordinate q_j, in the axes of the
    # body.
    for j in range(6):
        wx, wy, wz = rates[3, j], rates[4, j], rates[5, j]
        vx = rates[0, j] + wy * z - wz * y
        vy = rates[1, j] + wz * x - wx * z
        vz = rates[2, j] + wx * y - wy * x
        for i in range(3):
            a, b, c = mounting[0, i], mounting[1, i], mounting[2, i]
            jacobian[i, j] = a * vx + b * vy + c * vz
            jacobian[3 + i, j] = a * wx + b * wy + c * wz


@jit("f8[::1], f8[:]", allocates=False)
def move_freely(q, motion):
    """Move the coordinates q (6,) by a motion (6,) along a constant twist of the body.

    The new coordinates are the logarithm of exponential(q) @ exponential(motion).
    """
    a = compute_exponential(q[0], q[1], q[2], q[3], q[4], q[5])
    b = compute_exponential(
        motion[0], motion[1], motion[2], motion[3], motion[4], motion[5]
    )
    twist = compute_logarithm(
        a[0] * b[0] + a[1] * b[4] + a[2] * b[8], a[0] * b[1] + a[1] * b[5] + a[2] * b[9],
        a[0] * b[2] + a[1] * b[6] + a[2] * b[10], a[0] * b[3] + a[1] * b[7] + a[2] * b[11] + a[3],
        a[4] * b[0] + a[5] * b[4] + a[6] * b[8], a[4] * b[1] + a[5] * b[5] + a[6] * b[9],
        a[4] * b[2] + a[5] * b[6] + a[6] * b[10], a[4] * b[3] + a[5] * b[7] + a[6] * b[11] + a[7],
        a[8] * b[0] + a[9] * b[4] + a[10] * b[8], a[8] * b[1] + a[9] * b[5] + a[10] * b[9],
        a[8] * b[2] + a[9] * b[6] + a[10] * b[10],
        a[8] * b[3] + a[9] * b[7] + a[10] * b[11] + a[11],
    )  # fmt: skip
    q[0], q[1], q[2], q[3], q[4], q[5] = twist


@jit("f8[:,:], f8[::1]", allocates=False)
def write_logarithm(a_T_b, twist):
    """Write `poses.logarithm` of a pose (4, 4) into `twist` (6,)."""
    x, y, z = a_T_b[0], a_T_b[1], a_T_b[2]
    twist[0], twist[1], twist[2], twist[3], twist[4], twist[5] = compute_logarithm(
        x[0], x[1], x[2], x[3], y[0], y[1], y[2], y[3], z[0], z[1], z[2], z[3]
    )


@jit("f8[:]")
def _compute_right_jacobian(twist):
    """Compute the right Jacobian J (6, 6) of the exponential map of SE(3).

    If a_T_b = exponential(twist), then J @ d(twist)/dt is the twist of b, in the frame of b. J is
    the sum of (-ad(twist))^k / (k + 1)! over k >= 0, to machine precision.
    """
    vx, vy, vz, x, y, z = twist
    turn, move = np.zeros((3, 3)), np.zeros((3, 3))
    turn[0, 1], turn[0, 2], turn[1, 0], turn[1, 2], turn[2, 0], turn[2, 1] = -z, y, z, -x, -y, x
    move[0, 1], move[0, 2], move[1, 0], move[1, 2], move[2, 0], move[2, 1] = (
        -vz, vy, vz, -vx, -vy, vx
    )  # fmt: skip
    # Only the upper three rows of the 6 x 6 matrix J are summed. Its lower right block equals its
    # upper left block, and its lower left block is zero.
    rate, term, following, k = np.zeros((3, 6)), np.zeros((3, 6)), np.empty((3, 6)), 1
    for i in range(3):
        rate[i, i] = term[i, i] = 1.0
    largest = 1.0
    while largest > 1e-17:
        k, largest = k + 1, 0.0
        for i in range(3):
            for j in range(6):
                total = 0.0
                for m in range(3):
                    total -= turn[i, m] * term[m, j]
                    if j > 2:
                        total -= move[i, m] * term[m, j - 3]
                following[i, j] = total / k
                largest = max(largest, abs(following[i, j]))
        term, following = following, term
        for i in range(3):
            for j in range(6):
                rate[i, j] += term[i, j]
    whole = np.zeros((6, 6))
    for i in range(3):
        for j in range(3):
            whole[i, j] = whole[3 + i, 3 + j] = rate[i, j]
            whole[i, 3 + j] = rate[i, 3 + j]
    return whole
