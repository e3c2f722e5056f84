"""Viscous joint damping that is right for any d dt / I.

Bullet applies URDF damping explicitly, tau = -d v, which rings past d dt / I = 1 and diverges past
2. Three regimes, chosen by the largest eigenvalue r of dt D^1/2 M^-1 D^1/2:

- r <= EXPLICIT_BOUND: Bullet's own, in its step, at no cost. Terminal velocities are exact, a decay
  rate is off by r/2.
- above, fixed base: implicit Euler in this file. p = M v + dt (tau - h) is the momentum of the
  joints without damping; Coulomb friction takes up to dt f of it; v+ = (M + dt D)^-1 p;
  the torque is -D v+. Stable and monotone for every D, exact terminal velocity.
- above, free base: each stiff joint gets a velocity motor that removes the share
  r_i / (1 + r_i) of its velocity, r_i = d_i dt (M^-1)_ii: implicit Euler joint by joint. Such a
  joint has no Coulomb friction of its own.
"""

from typing import TYPE_CHECKING

import numpy as np

from aras_sim_bridge.world.bullet import pybullet

if TYPE_CHECKING:
    from aras_sim_bridge.world.model_joints import ModelJoints

EXPLICIT_BOUND = 0.5
CHECK_EVERY = 200  # steps; inertia changes with the configuration, slowly at 1 ms


class ViscousDamping:
    """Applies the damping of one model's joints; made anew whenever the model is loaded."""

    def __init__(self, joints: "ModelJoints") -> None:
        self._joints = joints
        self._countdown = 0
        self._implicit = False
        self._motors: set[int] = set()
        self.coefficients = np.array(joints.damping_coefficients)

    def before_step(self, dt: float) -> np.ndarray | None:
        """Torques to add to this step's efforts, (n,), or None when Bullet does all.

        To be called once before each step, with the model's pending efforts complete.
        """
        if self._countdown == 0:
            self._choose(dt)
            self._countdown = CHECK_EVERY
        self._countdown -= 1
        return self._implicit_torques(dt) if self._implicit else None

    def changed(self) -> None:
        """Configuration, damping or inertia jumped: choose again at the next step."""
        self.coefficients = np.array(self._joints.damping_coefficients)
        self._countdown = 0

    def _mass_matrix(self) -> np.ndarray:
        """Joint-space inertia, base rows first when it is free."""
        joints = self._joints
        matrix = np.array(pybullet.calculateMassMatrix(
            joints.body.body_id, joints.bullet_positions(), physicsClientId=joints.body.client))
        offset = 0 if joints.body.fixed_base else 6
        order = [*range(offset), *(offset + i for i in joints.dof_order)]
        return matrix[np.ix_(order, order)]

    def _choose(self, dt: float) -> None:
        d = self.coefficients
        stiffness = np.zeros(len(d))
        largest = 0.0
        if d.any():
            inverse = np.linalg.pinv(self._mass_matrix())[-len(d):, -len(d):]
            root = np.sqrt(d)
            stiffness = d * dt * np.diag(inverse)
            largest = dt * float(np.linalg.eigvalsh(root[:, None] * inverse * root)[-1])
        stiff = largest > EXPLICIT_BOUND
        self._implicit = stiff and self._joints.body.fixed_base
        motors: set[int] = set()
        if stiff and not self._implicit:
            motors = {i for i, r in enumerate(stiffness) if r > EXPLICIT_BOUND / len(d)}
        for i in self._motors - motors:
            self._joints.restore_friction(i)
        self._motors = motors
        for i, value in enumerate(d):
            mine = self._implicit or i in motors
            self._joints.set_bullet_damping(i, 0.0 if mine else float(value))
        for i in motors:
            self._joints.set_damping_motor(i, float(stiffness[i] / (1.0 + stiffness[i])))

    def _implicit_torques(self, dt: float) -> np.ndarray:
        joints = self._joints
        velocities = joints.read()[1]
        inertia = self._mass_matrix()
        forces = np.array(joints.pending_efforts) - np.array(joints.bias_efforts())
        momentum = inertia @ np.array(velocities) + dt * forces
        held = dt * np.array(joints.active_friction)
        momentum = np.sign(momentum) * np.maximum(np.abs(momentum) - held, 0.0)
        damped = np.linalg.solve(inertia + dt * np.diag(self.coefficients), momentum)
        return -self.coefficients * damped
