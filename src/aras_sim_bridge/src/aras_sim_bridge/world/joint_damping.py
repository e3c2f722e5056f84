"""Viscous joint damping of models with a free base, stable for any damping and time step.

Bullet applies the damping d of a URDF joint explicitly: tau = -d v, with the joint velocity v
before the step. With the inertia I and the time step dt, the velocity oscillates if d dt / I > 1
and diverges if d dt / I > 2. Therefore the method depends on r, the largest eigenvalue of
dt D^1/2 M^-1 D^1/2, where M is the mass matrix and D the diagonal matrix of the joints' damping:

- r <= EXPLICIT_BOUND: Bullet's explicit damping is used, which takes no time. Terminal velocities
  are exact; the decay rate has a relative error of r/2.
- r > EXPLICIT_BOUND: each stiff joint i gets a velocity motor, which removes the fraction
  r_i / (1 + r_i) of its velocity in each step, with r_i = d_i dt (M^-1)_ii. This is the implicit
  Euler method for each joint. The motor replaces the joint's Coulomb friction.

For models with a fixed base, joint_dynamics.py computes the damping.
"""

from typing import Protocol

import numpy as np

EXPLICIT_BOUND = 0.5
# Number of steps between two choices of the damping method. The inertia of the joints changes
# little in this time.
CHECK_EVERY = 200


class DampedJoints(Protocol):
    """Interface of a model's joints, implemented by ModelJoints.

    The index `slot` of a joint is its index in the lists below.

    Attributes:
        damping_coefficients: viscous damping of each joint, N m s/rad or N s/m.
        stiffness: stiffness of each joint's spring, N m/rad or N/m.
    """

    damping_coefficients: list[float]
    stiffness: list[float]

    def inverse_inertia(self) -> np.ndarray: ...
    def restore_friction(self, slot: int) -> None: ...
    def set_bullet_damping(self, slot: int, damping: float) -> None: ...
    def set_damping_motor(self, slot: int, share: float) -> None: ...


class JointDamping:
    """Damping of the joints of one model. Each time the model is loaded, a new object is created.

    Attributes:
        springs: stiffness of the springs by joint index, N m/rad or N/m. It is smaller than the
            true stiffness: an explicit step with it equals an implicit step with the true
            stiffness, if only this joint moves.
    """

    def __init__(self, joints: DampedJoints) -> None:
        self._joints = joints
        self._countdown = 0
        self._motors: set[int] = set()
        self.springs: dict[int, float] = {}

    def before_step(self, dt: float) -> None:
        """Choose the damping method every CHECK_EVERY steps. Call this before each step."""
        if self._countdown == 0:
            self._choose_method(dt)
            self._countdown = CHECK_EVERY
        self._countdown -= 1

    def invalidate(self) -> None:
        """Choose the damping method again at the next step.

        Call this after positions, inertia or time step have changed.
        """
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
