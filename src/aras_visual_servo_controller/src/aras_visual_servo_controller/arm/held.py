"""Directions of the camera that a task does not model are held, relative to the goal.

Twists are scaled here: the rotations by a length, so that all six numbers are in m/s.
"""

from math import atan2, sqrt

import numpy as np

from aras_visual_servo_base.compiled import compiled


@compiled("f8[:,:], f8[:,:]")
def _turn(view, goal):
    """Axis times angle (3,), rad, by which the camera has to turn, in its own frame."""
    R = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                R[i, j] += view[k, i] * goal[k, j]
    odd = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = 0.5 * sqrt((odd * odd).sum())
    cosine = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    angle = atan2(sine, cosine)
    if sine > 1e-4 or cosine > 0.0:
        return (0.5 * angle / sine if sine > 1e-6 else 0.5) * odd
    # Near half a turn the symmetric part is exact: (R + R^T) / 2 - cosine = (1 - cosine) u u^T.
    outer = 0.5 * (R + R.T) - cosine * np.eye(3)
    longest = 0
    for i in range(3):
        if outer[i, i] > outer[longest, longest]:
            longest = i
    axis = outer[longest].copy()
    size = sqrt((axis * axis).sum())
    if (axis * odd).sum() < 0.0:
        size = -size
    return angle / size * axis


@compiled("f8[:,:], f8[:,:], f8, i8, f8[:,::1], f8[::1]")
def _vertical(view, goal, length, row, held, errors):
    """What keeps the reference's vertical where it is in the camera's frame at the goal, whatever
    the camera's tilt: two rotations, into held (p, 6) and errors (p,) from `row` on.

    Args:
        view, goal: `reference_T_camera` (4, 4), now and at the goal.
        length: m that weigh as much as one radian.
    """
    now, wanted = view[2, :3].copy(), goal[2, :3].copy()
    first = np.array([0.0, now[2], -now[1]])
    if abs(now[0]) >= 0.7:
        first = np.array([-now[2], 0.0, now[0]])
    first /= np.sqrt((first * first).sum())
    second = np.cross(now, first)
    # Turning the camera by w moves what stands still by -w x c in its frame.
    turn = np.cross(wanted, now)
    sine, cosine = np.sqrt((turn * turn).sum()), (now * wanted).sum()
    if sine >= 1e-9:
        factor = length * np.arctan2(sine, cosine) / sine
        errors[row] = factor * (turn * first).sum()
        errors[row + 1] = factor * (turn * second).sum()
    elif cosine <= 0.0:  # upside down: any way round is as good
        errors[row] = length * np.pi
    held[row, 3:], held[row + 1, 3:] = first, second


@compiled("f8[:,:], f8[:,:], b1[:], f8")
def held_at(view, goal, modelled, length):
    """What is held of a camera that should be at a goal; p of its directions.

    Where wx and wy are not modelled and wz is, the reference's vertical (its z axis) keeps its
    place in the camera's frame: turning about it stays free, whatever the camera's tilt.

    Args:
        view, goal: `reference_T_camera` (4, 4), now and at the goal.
        modelled: (6,) bool, directions that the task speaks of.
        length: m that weigh as much as one radian.

    Returns:
        Orthonormal directions held (p, 6); how far the camera is off along them (p,), to be driven
        to 0 by rate = gain error, m (angles times the length); orthonormal others (6 - p, 6).
    """
    known = 0
    for i in range(6):
        known += modelled[i]
    held, errors, free = np.zeros((6 - known, 6)), np.zeros(6 - known), np.zeros((known, 6))
    upright = not modelled[3] and not modelled[4] and modelled[5]
    off, turns = np.zeros(6), not (modelled[3] and modelled[4] and modelled[5])
    for i in range(3):
        for k in range(3):
            off[i] += (goal[k, 3] - view[k, 3]) * view[k, i]
    if turns and not upright:
        off[3:] = length * _turn(view, goal)
    rows, others = 0, 0
    for i in range(3 if upright else 6):
        if modelled[i]:
            free[others, i] = 1.0
            others += 1
        else:
            held[rows, i], errors[rows] = 1.0, off[i]
            rows += 1
    if upright:
        free[others, 3:] = view[2, :3]
        _vertical(view, goal, length, rows, held, errors)
    return held, errors, free
