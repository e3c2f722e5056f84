"""Directions of the camera that a task does not model are held, relative to the goal.

Twists are scaled here: the rotations by a length, so that all six numbers are in m/s.
"""

import math
from collections.abc import Sequence

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
        vx, vy, vz, wx, wy, wz = modelled.tolist()
        if vx and vy and vz and wz and not wx and not wy:  # the usual case, with the least ado
            self._keep_vertical(view, goal, length)
            return
        rows: list[np.ndarray] = []
        errors: list[float] = []
        free: list[np.ndarray] = []
        place = (goal[:3, 3] - view[:3, 3]) @ view[:3, :3]
        for i, known in enumerate((vx, vy, vz)):
            if known:
                free.append(_AXES[i])
            else:
                rows.append(_AXES[i])
                errors.append(float(place[i]))
        if wz and not wx and not wy:
            self._keep_vertical(view, goal, length)
            rows += list(self.rows)
            errors += list(self.errors)
            free.append(self.free[-1])
        else:
            turn = length * rotation_vector(view[:3, :3].T @ goal[:3, :3])
            for i, known in enumerate((wx, wy, wz)):
                if known:
                    free.append(_AXES[3 + i])
                else:
                    rows.append(_AXES[3 + i])
                    errors.append(float(turn[i]))
        self.rows, self.errors = np.array(rows), np.array(errors)
        self.free = np.array(free) if free else np.zeros((0, 6))

    def _keep_vertical(self, view: np.ndarray, goal: np.ndarray, length: float) -> None:
        """Hold the vertical in the camera's frame; translations and turning about it are free."""
        vertical = view[2, :3].tolist()
        first, second = _across(*vertical)
        one, two = _turn(vertical, goal[2, :3].tolist(), (first, second))
        self.rows = np.array([(0.0, 0.0, 0.0, *first), (0.0, 0.0, 0.0, *second)])
        self.errors = np.array([length * one, length * two])
        self.free = _AXES[:4].copy()
        self.free[3, 3:] = vertical


_AXES = np.eye(6)


def _across(
    x: float, y: float, z: float
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Two unit vectors across a unit vector and each other; np.cross takes longer."""
    if abs(x) < 0.7:
        size = math.hypot(y, z)
        first = (0.0, z / size, -y / size)
    else:
        size = math.hypot(x, z)
        first = (-z / size, 0.0, x / size)
    u, v, w = first
    return first, (y * w - z * v, z * u - x * w, x * v - y * u)


def _turn(
    vertical: Sequence[float], wanted: Sequence[float], sideways: Sequence[Sequence[float]]
) -> list[float]:
    """Rotation of the camera that brings the vertical to its wanted place, along `sideways`, rad.

    Turning the camera by w moves what stands still by -w x c in its frame.
    """
    x, y, z = vertical
    a, b, c = wanted
    turn = (b * z - c * y, c * x - a * z, a * y - b * x)  # wanted x vertical
    sine = math.hypot(*turn)
    cosine = x * a + y * b + z * c
    if sine < 1e-9:
        # Upside down, any way round is as good.
        return [0.0, 0.0] if cosine > 0.0 else [math.pi, 0.0]
    factor = math.atan2(sine, cosine) / sine
    return [factor * (turn[0] * u + turn[1] * v + turn[2] * w) for u, v, w in sideways]
