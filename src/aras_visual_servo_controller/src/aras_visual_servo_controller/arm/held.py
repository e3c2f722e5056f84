"""Directions of the camera that a task does not model are held, relative to the goal.

Twists are scaled here: the rotations by a length, so that all six numbers are in m/s.
"""

from typing import NamedTuple

import numpy as np

from aras_visual_servo_base.compiled import compiled
from aras_visual_servo_base.poses import rotation_vector


class Held(NamedTuple):
    """What is held at one view.

    Attributes:
        rows: (p, 6) orthonormal, directions held.
        errors: (p,) how far the camera is off along them, to be driven to 0 by rate = gain error,
            m (angles times the length).
        free: (6 - p, 6) orthonormal, the other directions.
    """

    rows: np.ndarray
    errors: np.ndarray
    free: np.ndarray


_AXES = np.eye(6)
_NOTHING = Held(np.zeros((0, 6)), np.zeros(0), _AXES)


def held_at(
    view: np.ndarray, goal: np.ndarray, modelled: np.ndarray, length: float
) -> Held:
    """What is held of a camera that should be at a goal.

    Where wx and wy are not modelled and wz is, the reference's vertical (its z axis) keeps its
    place in the camera's frame: turning about it stays free, whatever the camera's tilt.

    Args:
        view, goal: `reference_T_camera` (4, 4), now and at the goal.
        modelled: (6,) bool, directions that the task speaks of.
        length: m that weigh as much as one radian.
    """
    known = modelled.tolist()
    if all(known):
        return _NOTHING
    upright = known[3:] == [False, False, True]
    if upright and all(known[:3]):  # the usual case, with the least ado
        return Held(*_vertical(view, goal, length))
    off = np.zeros(6)
    off[:3] = (goal[:3, 3] - view[:3, 3]) @ view[:3, :3]
    if upright:
        turning = Held(*_vertical(view, goal, length))
        here, there = [i for i in range(3) if not known[i]], [i for i in range(3) if known[i]]
        return Held(
            np.concatenate([_AXES[here], turning.rows]),
            np.concatenate([off[here], turning.errors]),
            np.concatenate([_AXES[there], turning.free[3:]]),
        )
    off[3:] = length * rotation_vector(view[:3, :3].T @ goal[:3, :3])
    return Held(_AXES[~modelled], off[~modelled], _AXES[modelled])


@compiled("f8[:,:], f8[:,:], f8")
def _vertical(view, goal, length):
    """What keeps the reference's vertical where it is in the camera's frame at the goal.

    Translations and turning about it are free, whatever the camera's tilt.

    Args:
        view, goal: `reference_T_camera` (4, 4), now and at the goal.
        length: m that weigh as much as one radian.

    Returns:
        held (2, 6), errors (2,), free (4, 6), as in Held.
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
    errors = np.zeros(2)
    if sine >= 1e-9:
        factor = length * np.arctan2(sine, cosine) / sine
        errors[0], errors[1] = factor * (turn * first).sum(), factor * (turn * second).sum()
    elif cosine <= 0.0:  # upside down: any way round is as good
        errors[0] = length * np.pi
    held, free = np.zeros((2, 6)), np.eye(6)[:4].copy()
    held[0, 3:], held[1, 3:], free[3, 3:] = first, second, now
    return held, errors, free
