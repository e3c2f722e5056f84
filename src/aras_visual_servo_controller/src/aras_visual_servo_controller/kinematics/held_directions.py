"""Held directions: camera directions in which the camera is held at the goal.

The task does not control these directions. Rotations in twists are multiplied by a length, so that
all six components are in m/s.
"""

from math import atan2, pi, sqrt

import numpy as np

from aras_visual_servo_base.compiled import jit


@jit("f8[:], f8[:], f8[::1]", allocates=False)
def _cross(a, b, product):
    """Write a x b into `product`."""
    product[0] = a[1] * b[2] - a[2] * b[1]
    product[1] = a[2] * b[0] - a[0] * b[2]
    product[2] = a[0] * b[1] - a[1] * b[0]


@jit("f8[:], f8[:]", allocates=False)
def _dot(a, b):
    """Compute the dot product of a and b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@jit("f8[:,:], f8[:,:], f8, f8[::1]")
def _compute_rotation_error(pose, goal, length, errors):
    """Write the rotation from pose to goal, in the camera frame, into errors[3:6].

    The rotation is written as axis times angle (rad) times the length.
    """
    R, odd, axis = np.zeros((3, 3)), np.empty(3), np.empty(3)
    for i in range(3):
        for j in range(3):
            for k in range(3):
                R[i, j] += pose[k, i] * goal[k, j]
    for i in range(3):
        odd[i] = R[(i + 2) % 3, (i + 1) % 3] - R[(i + 1) % 3, (i + 2) % 3]
    sine = 0.5 * sqrt(_dot(odd, odd))
    cosine = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    angle = atan2(sine, cosine)
    factor = 0.5 * angle / sine if sine > 1e-6 else 0.5
    if sine <= 1e-4 and cosine <= 0.0:
        # Near half a turn, the rotation axis u is computed from the symmetric part of the rotation
        # matrix R, because (R + R^T) / 2 - cosine I = (1 - cosine) u u^T. The column with the
        # largest diagonal element is parallel to u.
        longest = 0
        for i in range(3):
            if R[i, i] > R[longest, longest]:
                longest = i
        for i in range(3):
            axis[i] = 0.5 * (R[longest, i] + R[i, longest])
        axis[longest] -= cosine
        factor = angle / sqrt(_dot(axis, axis))
        if _dot(axis, odd) < 0.0:
            factor = -factor
        odd = axis
    for i in range(3):
        errors[3 + i] = length * factor * odd[i]


@jit("f8[:,:], f8[:,:], f8, i8, f8[:,::1], f8[::1]")
def _hold_vertical(pose, goal, length, row, held_directions, errors):
    """Compute the two rotations that move the vertical to its direction at the goal.

    The vertical is the z axis of the reference frame, expressed in the camera frame. The two axes
    of rotation and the two angles are written into rows `row` and `row` + 1 of the outputs.

    Args:
        pose, goal: present and desired `reference_T_camera` (4, 4).
        length: length that has the same weight as 1 rad, m.
        row: first row to write.
        held_directions: (p, 6) output: axes of rotation in the camera frame, as unit twists.
        errors: (p,) output: angles times `length`, m.
    """
    now, desired = pose[2, :3], goal[2, :3]
    first, second, turn = np.zeros(3), np.empty(3), np.empty(3)
    if abs(now[0]) >= 0.7:
        first[0], first[2] = -now[2], now[0]
    else:
        first[1], first[2] = now[2], -now[1]
    size = sqrt(_dot(first, first))
    for i in range(3):
        first[i] /= size
    _cross(now, first, second)
    # A rotation of the camera by w changes a fixed direction c by -w x c in the camera frame.
    _cross(desired, now, turn)
    sine, cosine = sqrt(_dot(turn, turn)), _dot(now, desired)
    if sine >= 1e-9:
        factor = length * atan2(sine, cosine) / sine
        errors[row] = factor * _dot(turn, first)
        errors[row + 1] = factor * _dot(turn, second)
    elif cosine <= 0.0:
        # The vertical is opposite to its direction at the goal. A rotation by pi about any axis
        # normal to it corrects this.
        errors[row] = length * pi
    for i in range(3):
        held_directions[row, 3 + i], held_directions[row + 1, 3 + i] = first[i], second[i]


@jit("f8[:,:], f8[:,:], b1[:], f8")
def compute_held_directions(pose, goal, modelled, length):
    """Compute the directions in which the camera is held, and its offset from the goal along them.

    If a task controls wz but not wx and wy, the camera's tilt is held: the z axis of the reference
    keeps the direction in the camera frame that it has at the goal. The task controls the rotation
    about this z axis.

    Args:
        pose, goal: present and desired `reference_T_camera` (4, 4).
        modelled: (6,) whether the task controls each direction.
        length: length that has the same weight as 1 rad, m.

    Returns:
        The orthonormal held directions (p, 6); the desired displacements (p,) of the camera along
        them, m (angles times the length); the orthonormal free directions (6 - p, 6).
    """
    known = 0
    for i in range(6):
        known += modelled[i]
    held, errors, free = np.zeros((6 - known, 6)), np.zeros(6 - known), np.zeros((known, 6))
    upright = not modelled[3] and not modelled[4] and modelled[5]
    off, turns = np.zeros(6), not (modelled[3] and modelled[4] and modelled[5])
    for i in range(3):
        for k in range(3):
            off[i] += (goal[k, 3] - pose[k, 3]) * pose[k, i]
    if turns and not upright:
        _compute_rotation_error(pose, goal, length, off)
    rows, others = 0, 0
    for i in range(3 if upright else 6):
        if modelled[i]:
            free[others, i] = 1.0
            others += 1
        else:
            held[rows, i], errors[rows] = 1.0, off[i]
            rows += 1
    if upright:
        for i in range(3):
            free[others, 3 + i] = pose[2, i]
        _hold_vertical(pose, goal, length, rows, held, errors)
    return held, errors, free
