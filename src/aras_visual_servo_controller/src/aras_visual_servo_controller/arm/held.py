"""Directions of the camera that a task does not model are held, relative to the goal.

Twists are scaled here: the rotations by a length, so that all six numbers are in m/s.
"""

import numpy as np

from .poses import rotation_vector


class Held:
    """What is held at one view.

    Attributes:
        rows: (p, 6) orthonormal, directions held.
        errors: (p,) how far the camera is off along them, to be driven to 0 by rate = gain error,
            m (angles times the length).
        free: (6 - p, 6) orthonormal, the other directions.
    """

    def __init__(
        self, view: np.ndarray, goal: np.ndarray, modelled: np.ndarray, length: float
    ) -> None:
        """Look at a camera that should be at a goal.

        Where wx and wy are not modelled and wz is, the reference's vertical (its z axis) keeps
        its place in the camera's frame: turning about it stays free, whatever the camera's tilt.

        Args:
            view, goal: `reference_T_camera` (4, 4), now and at the goal.
            modelled: (6,) bool, directions that the task speaks of.
            length: m that weigh as much as one radian.
        """
        rows: list[np.ndarray] = []
        errors: list[float] = []
        free: list[np.ndarray] = []
        if not modelled[:3].all():
            place = (goal[:3, 3] - view[:3, 3]) @ view[:3, :3]
        for i in range(3):
            if modelled[i]:
                free.append(_AXES[i])
            else:
                rows.append(_AXES[i])
                errors.append(float(place[i]))
        if modelled[3:].all():
            free += [_AXES[3], _AXES[4], _AXES[5]]
        elif modelled[5] and not modelled[3] and not modelled[4]:
            vertical, sideways = view[2, :3], _across(view[2, :3])
            for axis in sideways:
                rows.append(np.array((0.0, 0.0, 0.0, *axis)))
            errors += [length * value for value in _turn(vertical, goal[2, :3], sideways)]
            free.append(np.concatenate([_AXES[0][:3] * 0.0, vertical]))
        else:
            turn = length * rotation_vector(view[:3, :3].T @ goal[:3, :3])
            for i in range(3):
                if modelled[3 + i]:
                    free.append(_AXES[3 + i])
                else:
                    rows.append(_AXES[3 + i])
                    errors.append(float(turn[i]))
        self.rows = np.array(rows) if rows else np.zeros((0, 6))
        self.errors = np.array(errors)
        self.free = np.array(free) if free else np.zeros((0, 6))


_AXES = np.eye(6)


def _across(c: np.ndarray) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Two unit vectors across a unit vector c (3,) and each other; np.cross takes longer."""
    x, y, z = (float(v) for v in c)
    if abs(x) < 0.7:
        size = (y * y + z * z) ** 0.5
        first = (0.0, z / size, -y / size)
    else:
        size = (x * x + z * z) ** 0.5
        first = (-z / size, 0.0, x / size)
    u, v, w = first
    return first, (y * w - z * v, z * u - x * w, x * v - y * u)


def _turn(
    vertical: np.ndarray, wanted: np.ndarray, sideways: tuple[tuple[float, float, float], ...]
) -> list[float]:
    """Rotation of the camera that brings the vertical to its wanted place, along `sideways`, rad.

    Turning the camera by w moves what stands still by -w x c in its frame.
    """
    x, y, z = (float(v) for v in vertical)
    a, b, c = (float(v) for v in wanted)
    turn = (b * z - c * y, c * x - a * z, a * y - b * x)  # wanted x vertical
    sine = (turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2) ** 0.5
    cosine = x * a + y * b + z * c
    if sine < 1e-9:
        # Upside down, any way round is as good.
        return [0.0, 0.0] if cosine > 0.0 else [float(np.pi), 0.0]
    factor = float(np.arctan2(sine, cosine)) / sine
    return [factor * (turn[0] * u + turn[1] * v + turn[2] * w) for u, v, w in sideways]
