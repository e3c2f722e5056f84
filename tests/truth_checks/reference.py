"""Independent simulation of joints: Pinocchio's equations of motion and a Gauss-Seidel solver."""

from __future__ import annotations

import numpy as np
import pinocchio

_SWEEPS = 20000
_SMALL = 1e-14


class Reference:
    """Robot with a fixed base, integrated by semi-implicit Euler with implicit damping:

        (M + dt D) v+ = M v + dt (effort - bias) - impulse,  |impulse_i| <= dt friction_i
        q+ = q + dt v+

    The friction impulses minimise the joint speeds (maximum dissipation).

    Attributes:
        q, v: (n,) joint positions and velocities, rad or m, per s.
    """

    def __init__(self, model: pinocchio.Model, damping: np.ndarray, friction: np.ndarray) -> None:
        if model.nq != model.nv:
            raise ValueError("continuous joints are not supported by this reference")
        self._model, self._data = model, model.createData()
        self._damping, self._friction = np.asarray(damping, float), np.asarray(friction, float)
        self.q, self.v = np.zeros(model.nv), np.zeros(model.nv)

    def step(self, effort: np.ndarray, dt: float) -> None:
        half = pinocchio.crba(self._model, self._data, self.q)
        mass = np.triu(half) + np.triu(half, 1).T
        bias = pinocchio.nonLinearEffects(self._model, self._data, self.q, self.v)
        left = mass + dt * np.diag(self._damping)
        right = mass @ self.v + dt * (effort - bias)
        self.v = self._apply_friction(left, right, dt * self._friction)
        self.q = self.q + dt * self.v

    def _apply_friction(self, left: np.ndarray, right: np.ndarray, bound: np.ndarray) -> np.ndarray:
        """Compute the velocities after friction by projected Gauss-Seidel."""
        v = np.linalg.solve(left, right)
        if not bound.any():
            return v
        diagonal = np.diag(left)
        for _ in range(_SWEEPS):
            change = 0.0
            for i in range(len(v)):
                rest = right[i] - left[i] @ v + diagonal[i] * v[i]
                new = (rest - np.clip(rest, -bound[i], bound[i])) / diagonal[i]
                change = max(change, abs(new - v[i]))
                v[i] = new
            if change < _SMALL:
                return v
        raise RuntimeError("the friction solver did not converge")
