"""Viscous joint damping of free-base models, stable for any d dt / I.

Bullet applies URDF damping explicitly, tau = -d v. This oscillates if d dt / I > 1 and diverges if
d dt / I > 2. The method depends on r, the largest eigenvalue of dt D^1/2 M^-1 D^1/2:

- r <= EXPLICIT_BOUND: Bullet's explicit damping, at no cost. Terminal velocities are exact; the
  decay rate has a relative error of r/2.
- r > EXPLICIT_BOUND: each stiff joint gets a velocity motor that removes the share r_i / (1 + r_i)
  of its velocity, with r_i = d_i dt (M^-1)_ii. This is implicit Euler for each joint. The motor
  replaces the joint's Coulomb friction.

Fixed-base models have their damping from joint_dynamics.py.
"""

from typing import Protocol

import numpy as np

EXPLICIT_BOUND = 0.5
CHECK_EVERY = 200  # steps; the inertia changes slowly with the configuration at 1 ms


class DampedJoints(Protocol):
    """Interface of a model's joints, implemented by ModelJoints.

    A joint is identified by its index `slot` in `damping_coefficients` (N m s/rad or N s/m) and
    `stiffness` (N m/rad or N/m).
    """

    damping_coefficients: list[float]
    stiffness: list[float]

    def inverse_inertia(self) -> np.ndarray: ...
    def restore_friction(self, slot: int) -> None: ...
    def set_bullet_damping(self, slot: int, damping: float) -> None: ...
    def set_damping_motor(self, slot: int, share: float) -> None: ...


class JointDamping:
    """Damping of the joints of one model; a new one is made when the model is loaded.

    Attributes:
        springs: stiffness by joint, reduced such that the explicit step of a spring equals the
            implicit step of a single joint.
    """

    def __init__(self, joints: DampedJoints) -> None:
        self._joints = joints
        self._countdown = 0
        self._motors: set[int] = set()
        self.springs: dict[int, float] = {}

    def before_step(self, dt: float) -> None:
        """Choose the damping method every CHECK_EVERY steps; called before each step."""
        if self._countdown == 0:
            self._choose_method(dt)
            self._countdown = CHECK_EVERY
        self._countdown -= 1

    def invalidate(self) -> None:
        """Choose the method at the next step, after a jump of joints, inertia or time step."""
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
