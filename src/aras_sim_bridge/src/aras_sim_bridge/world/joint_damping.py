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

from collections.abc import Callable, Sequence

import numpy as np

from aras_sim_bridge.world.bullet_body import BulletBody
from aras_sim_bridge.world.joint_dynamics import NO_LIMIT_FORCE
from aras_visual_servo_base.urdf import Joint

EXPLICIT_BOUND = 0.5
# Number of steps between two choices of the damping method. The inertia of the joints changes
# little in this time.
CHECK_EVERY = 200


class JointDamping:
    """Damping and springs of the joints of a free model.

    Each time the model is loaded, a new object is created. The index `slot` of a joint is its index
    in the constructor's arguments.

    Args:
        body: body of the model in Bullet.
        indices: Bullet's index of each joint.
        joints: the joints.
        compute_inverse_inertia: function that returns the matrix that maps joint efforts to
            accelerations, in the present state.
    """

    def __init__(self, body: BulletBody, indices: Sequence[int], joints: Sequence[Joint],
                 compute_inverse_inertia: Callable[[], np.ndarray]) -> None:
        self._body, self._indices, self._joints = body, indices, joints
        self._damping = np.array([joint.damping for joint in joints])
        self._stiffness = np.array([joint.stiffness for joint in joints])
        self._compute_inverse_inertia = compute_inverse_inertia
        self._countdown = 0
        self._motors: set[int] = set()
        # Stiffness of the springs by slot, N m/rad or N/m. It is smaller than the true stiffness:
        # an explicit step with it equals an implicit step with the true stiffness, if only this
        # joint moves.
        self._springs: dict[int, float] = {}

    def before_step(self, dt: float) -> None:
        """Choose the damping method every CHECK_EVERY steps. Call this before each step."""
        if self._countdown == 0:
            self._choose_method(dt)
            self._countdown = CHECK_EVERY
        self._countdown -= 1

    def add_spring_efforts(
        self, efforts: Sequence[float], positions: Sequence[float], speeds: Sequence[float],
        dt: float
    ) -> Sequence[float]:
        """Return the efforts (N m or N) with those of the springs in the next step added.

        The positions (rad or m) and speeds (rad/s or m/s) are those before the step.
        """
        total = list(efforts) if self._springs else efforts
        for slot, k in self._springs.items():
            total[slot] -= k * (positions[slot] + dt * speeds[slot] - self._joints[slot].rest)
        return total

    def invalidate(self) -> None:
        """Choose the damping method again at the next step.

        Call this after positions, inertia or time step have changed.
        """
        self._countdown = 0

    def _choose_method(self, dt: float) -> None:
        d, k = self._damping, self._stiffness
        ratios = np.zeros(len(d))
        largest = 0.0
        if d.any() or k.any():
            inverse = self._compute_inverse_inertia()
            softened = k / (1.0 + k * dt * dt * np.diag(inverse))
            self._springs = {i: float(value) for i, value in enumerate(softened) if value}
            root = np.sqrt(d)
            ratios = d * dt * np.diag(inverse)
            largest = dt * float(np.linalg.eigvalsh(root[:, None] * inverse * root)[-1])
        motors: set[int] = set()
        if largest > EXPLICIT_BOUND:
            motors = {i for i, r in enumerate(ratios) if r > EXPLICIT_BOUND / len(d)}
        for i in self._motors - motors:
            self._body.set_velocity_motor(self._indices[i], 0.0, self._joints[i].friction)
        self._motors = motors
        for i, value in enumerate(d):
            self._body.change_joint(
                self._indices[i], jointDamping=0.0 if i in motors else float(value)
            )
        for i in motors:
            share = float(ratios[i] / (1.0 + ratios[i]))
            self._body.set_velocity_motor(self._indices[i], 0.0, NO_LIMIT_FORCE, share)
