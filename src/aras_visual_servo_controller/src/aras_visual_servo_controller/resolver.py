"""From the camera's twist to the velocities of the joints.

The five task degrees of freedom of the arm are vx, vy, vz and wz of the camera and the rate of its
pitch; the sixth of a camera, roll, the arm does not have. With T the five rows of the Jacobian
(rotations scaled by a length, so that all singular values are in metres per unit of joint), the
velocities are

    q_dot = sum_i  s_i / (s_i^2 + d_i^2)  v_i (u_i . task)  +  (I - V V^T) z

a damped least-squares solution (Nakamura and Hanafusa 1986; damping only the directions that need
it: Maciejewski and Klein 1988) plus the secondary tasks' z in the null space of T.

At the stretched arm the camera has no vertical velocity, and the laboratory's desired poses lie
there or 0.1 mm before it. Two measures make that a usable place:

- Going out, the elbow closes in on straight without ever passing it: the damping sees to it in
  continuous time, and half of the remaining bend is the most that one step may take.
- Coming back, T is taken at a slightly bent elbow: to first order nothing would move the camera
  up, to second order bending does. `reach_bend` is that bend.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from .kinematics import J2, J3, J5, JOINT_NAMES, Kinematics
from .tasks import JointLimits, Posture, Task

# The rate of the pitch is the sum of three joint rates, whatever the camera's mounting.
_PITCH = np.array([0.0, 0.0, 1.0, 1.0, 1.0, 0.0])


@dataclass(frozen=True)
class ResolverSettings:
    """Numbers of the resolver.

    Attributes:
        length: metres that weigh as much as one radian of camera rotation, m.
        damping: greatest damping d, m per unit of joint.
        damping_below: singular value under which a direction is damped, m per unit of joint.
        reach_bend: elbow angle at which the Jacobian is taken to come back from straight, rad.
        shortfall: missing speed of the camera at the stretched arm that is worth a word, m/s.
        elbow: side on which the elbow bends, +1 or -1 (the sign of J3), when it is straight.
    """

    length: float = 0.1
    damping: float = 0.003
    damping_below: float = 0.012
    reach_bend: float = 0.05
    shortfall: float = 0.002
    elbow: int = -1


@dataclass(frozen=True)
class Resolution:
    """Answer of the resolver.

    Attributes:
        joint_velocities: (6,), m/s and rad/s.
        twist: (6,) of the camera that these velocities give, optical frame.
        singular_values: (5,) of the task Jacobian that was inverted, m per unit, largest first.
        scale: 1, or the factor by which the whole motion was slowed for the speed limits.
        reasons: what held the motion back, in words; empty when nothing did.
    """

    joint_velocities: np.ndarray
    twist: np.ndarray
    singular_values: np.ndarray
    scale: float = 1.0
    reasons: tuple[str, ...] = field(default=())


class Resolver:
    """Inverts the arm's Jacobian with respect for singularities, limits and secondary tasks."""

    def __init__(
        self,
        kinematics: Kinematics,
        limits: JointLimits | None = None,
        tasks: Sequence[Task] | None = None,
        settings: ResolverSettings | None = None,
    ) -> None:
        self.kinematics = kinematics
        self.limits = limits if limits is not None else JointLimits()
        self.tasks = tuple(tasks) if tasks is not None else (Posture(),)
        self.settings = settings if settings is not None else ResolverSettings()

    def task_jacobian(self, q: np.ndarray) -> np.ndarray:
        """Rows (5, 6): vx, vy, vz, then length x pitch rate and length x wz, optical frame."""
        jacobian = self.kinematics.jacobian(q)
        return np.vstack([jacobian[:3], self.settings.length * np.array([_PITCH, jacobian[5]])])

    def resolve(self, q: np.ndarray, twist: np.ndarray, dt: float) -> Resolution:
        """Joint velocities for a twist (6,) of the camera, optical frame, at the posture q (6,).

        A joint that would leave its position limits within dt (s) stops there and the others do
        what they can; a joint too fast slows the whole motion, so that its direction is kept.

        Raises:
            ValueError: q, twist or dt is not finite.
        """
        q, twist = np.asarray(q, float), np.asarray(twist, float)
        if not (np.isfinite(q).all() and np.isfinite(twist).all() and np.isfinite(dt)):
            raise ValueError(f"resolver: not finite: joints {q}, twist {twist}, dt {dt}")
        axis = self.kinematics.pitch_axis(q)
        task = np.concatenate(
            [twist[:3], self.settings.length * np.array([axis @ twist[3:], twist[5]])]
        )
        wish = sum((entry.velocity(q) for entry in self.tasks), np.zeros(6))

        free = np.ones(6, bool)
        fixed = np.zeros(6)
        reasons: list[str] = []
        straight = False
        for _ in range(len(JOINT_NAMES) + 1):
            velocities, singular_values = self._solve_either_side(q, task, wish, free, fixed)
            if free[J3] and self._passes_straight(q, velocities, dt):
                fixed[J3], free[J3], straight = -0.5 * q[J3] / dt, False, True
                continue
            stopped = self._beyond(q, velocities, dt) & free
            if not stopped.any():
                break
            for joint in np.flatnonzero(stopped):
                bound = self._bound(joint, velocities[joint])
                # Go on to the limit itself, unless the joint already stands beyond it.
                room = bound - q[joint]
                fixed[joint] = room / dt if dt > 0.0 and room * velocities[joint] > 0.0 else 0.0
                reasons.append(f"{JOINT_NAMES[joint]} stopped at its limit of {bound:.4f}")
            free &= ~stopped

        achieved = self.kinematics.jacobian(q) @ velocities
        if straight and np.linalg.norm(achieved[:3] - twist[:3]) > self.settings.shortfall:
            reasons.append("the arm is stretched: what is asked lies beyond its reach")

        ratio = np.abs(velocities) / np.asarray(self.limits.velocity)
        fastest = int(np.argmax(ratio))
        scale = 1.0
        if ratio[fastest] > 1.0:
            scale = float(1.0 / ratio[fastest])
            velocities = scale * velocities
            reasons.append(
                f"slowed to {100.0 * scale:.0f} % for the speed limit of {JOINT_NAMES[fastest]}"
            )
        return Resolution(
            joint_velocities=velocities,
            twist=scale * achieved,
            singular_values=singular_values,
            scale=scale,
            reasons=tuple(reasons),
        )

    def _solve_either_side(
        self,
        q: np.ndarray,
        task: np.ndarray,
        wish: np.ndarray,
        free: np.ndarray,
        fixed: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Solve at q, or at a slightly bent elbow when that is the way back from straight."""
        side = np.sign(q[J3]) or float(self.settings.elbow)
        if abs(q[J3]) < self.settings.reach_bend:
            bent = self._bent(q, side)
            velocities, singular_values = self._solve(bent, task, wish, free, fixed)
            if velocities[J3] * side > 0.0:
                return velocities, singular_values
        return self._solve(q, task, wish, free, fixed)

    def _bent(self, q: np.ndarray, side: float) -> np.ndarray:
        """The posture q with its elbow bent by reach_bend, wrist direction and pitch kept."""
        g = self.kinematics.geometry
        bend = side * self.settings.reach_bend - q[J3]
        bent = q.copy()
        bent[J3] += bend
        bent[J2] -= bend * g.fore / (g.upper + g.fore)
        bent[J5] -= bend * g.upper / (g.upper + g.fore)
        return bent

    def _solve(
        self,
        q: np.ndarray,
        task: np.ndarray,
        wish: np.ndarray,
        free: np.ndarray,
        fixed: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Damped least squares over the free joints; the others move at their fixed velocity."""
        jacobian = self.task_jacobian(q)
        u, s, vt = np.linalg.svd(jacobian[:, free], full_matrices=False)
        small = s < self.settings.damping_below
        damping = np.where(
            small, self.settings.damping**2 * (1.0 - (s / self.settings.damping_below) ** 2), 0.0
        )
        gain = s / np.maximum(s**2 + damping, 1e-12)
        velocities = fixed.copy()
        moved = vt.T @ (gain * (u.T @ (task - jacobian @ fixed)))
        secondary = wish[free]
        velocities[free] = moved + secondary - vt.T @ (vt @ secondary)
        return velocities, s

    def _passes_straight(self, q: np.ndarray, velocities: np.ndarray, dt: float) -> bool:
        """Whether this step would take more than half of the elbow's small bend away."""
        closing = velocities[J3] * np.sign(q[J3]) < 0.0
        near = abs(q[J3]) < self.settings.reach_bend
        return bool(near and closing and abs(velocities[J3]) * dt > 0.5 * abs(q[J3]))

    def _bound(self, joint: int, velocity: float) -> float:
        return (self.limits.upper if velocity > 0.0 else self.limits.lower)[joint]

    def _beyond(self, q: np.ndarray, velocities: np.ndarray, dt: float) -> np.ndarray:
        """Joints (6,) bool that move outwards and would end outside their limits."""
        after = q + velocities * dt
        low = (velocities < 0.0) & (after < np.asarray(self.limits.lower) - 1e-12)
        return low | ((velocities > 0.0) & (after > np.asarray(self.limits.upper) + 1e-12))
