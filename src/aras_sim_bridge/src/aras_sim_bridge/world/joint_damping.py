"""Viscous joint damping of models that are not bolted down, right for any d dt / I.

Bullet applies URDF damping explicitly, tau = -d v, which rings past d dt / I = 1 and diverges past
2. Two regimes, chosen by the largest eigenvalue r of dt D^1/2 M^-1 D^1/2:

- r <= EXPLICIT_BOUND: Bullet's own, in its step, at no cost. Terminal velocities are exact, a decay
  rate is off by r/2.
- above: each stiff joint gets a velocity motor that removes the share r_i / (1 + r_i) of its
  velocity, r_i = d_i dt (M^-1)_ii: implicit Euler joint by joint. Such a joint has no Coulomb
  friction of its own.

The joints of a model that is bolted down have theirs from joint_dynamics.py.
"""

from typing import Protocol

import numpy as np

EXPLICIT_BOUND = 0.5
CHECK_EVERY = 200  # steps; inertia changes with the configuration, slowly at 1 ms


class DampedJoints(Protocol):
    """What is needed of a model's joints: ModelJoints, which holds the damping. Joints are named
    by their index in `damping_coefficients`, Nms/rad or Ns/m, and `stiffness`, Nm/rad or N/m."""

    damping_coefficients: list[float]
    stiffness: list[float]

    def inverse_inertia(self) -> np.ndarray: ...
    def restore_friction(self, slot: int) -> None: ...
    def set_bullet_damping(self, slot: int, damping: float) -> None: ...
    def set_damping_motor(self, slot: int, share: float) -> None: ...


class JointDamping:
    """Applies the damping of one model's joints; made anew whenever the model is loaded.

    springs: stiffness with which a spring acts in an explicit step as in an implicit one of its
    joint by itself, by joint.
    """

    def __init__(self, joints: DampedJoints) -> None:
        self._joints = joints
        self._countdown = 0
        self._motors: set[int] = set()
        self.springs: dict[int, float] = {}

    def before_step(self, dt: float) -> None:
        """To be called once before each step."""
        if self._countdown == 0:
            self._choose_method(dt)
            self._countdown = CHECK_EVERY
        self._countdown -= 1

    def invalidate(self) -> None:
        """Configuration, inertia or time step jumped: choose again at the next step."""
        self._countdown = 0

    def _choose_method(self, dt: float) -> None:
        d, k = (np.array(values) for values in (
            self._joints.damping_coefficients, self._joints.stiffness))
        stiffness = np.zeros(len(d))
        largest = 0.0
        if d.any() or k.any():
            inverse = self._joints.inverse_inertia()
            softened = k / (1.0 + k * dt * dt * np.diag(inverse))
            self.springs = {i: float(value) for i, value in enumerate(softened) if value}
            root = np.sqrt(d)
            stiffness = d * dt * np.diag(inverse)
            largest = dt * float(np.linalg.eigvalsh(root[:, None] * inverse * root)[-1])
        motors: set[int] = set()
        if largest > EXPLICIT_BOUND:
            motors = {i for i, r in enumerate(stiffness) if r > EXPLICIT_BOUND / len(d)}
        for i in self._motors - motors:
            self._joints.restore_friction(i)
        self._motors = motors
        for i, value in enumerate(d):
            self._joints.set_bullet_damping(i, 0.0 if i in motors else float(value))
        for i in motors:
            self._joints.set_damping_motor(i, float(stiffness[i] / (1.0 + stiffness[i])))
