"""From a task to the velocities of the joints.

With L the task's interaction matrix, J the arm's Jacobian and H the directions that the task does
not model, the velocities solve in the least-squares sense

    L J q_dot = e_dot        H J q_dot = hold_gain (goal - now)

twists scaled so that a radian counts as a length. Where the arm itself is near a singularity, its
weak joint motions v_i (those of J's singular values s_i below a bound) are damped by rows d_i v_i,
and nothing else is: away from singularities the solution is exact (Nakamura and Hanafusa 1986;
damping only the directions that need it: Maciejewski and Klein 1988). What the arm can do at all is
found from J, so four joints need no other words than seven. A held direction that the arm can
hardly move (the roll of a camera on two nearly parallel axes) is let go, gradually.

Secondary tasks add up, z, and get what the task does not see: q_dot += (I - A^+ T) z.

Limits: a joint that would leave its range stops at it and the others do what they can; limits of
speed and acceleration scale the task, in its direction; the secondary tasks get what they leave.

At a stretched elbow (`fold.py`) the camera has no velocity along the arm. Two measures make that a
usable place:

- Going out, the elbow closes in on straight without ever passing it: the damping sees to it in
  continuous time, and half of the remaining bend is the most that one step may take.
- Coming back, J is taken at a slightly bent elbow: to first order nothing would move the camera, to
  second order bending does. `reach_bend` is that bend.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..inversion import account, demanded, solved
from .arm import Arm
from .bounds import Bounds
from .fold import Fold, find
from .held import Held
from .limits import Limits
from .resolution import DIRECTIONS, LASTING, UNITS, Resolution
from .secondary import SecondaryTask

if TYPE_CHECKING:
    from ..task import Task

# Joints that move less than this leave the Jacobian as it is, beside an elbow too, rad or m.
STILL = 0.002

@dataclass(frozen=True)
class ResolverSettings:
    """Numbers of the resolver.

    Attributes:
        length: metres that weigh as much as one radian of camera rotation, m.
        damping: greatest damping, m per unit of joint.
        damping_below: singular value of J under which a joint motion is damped, m per unit.
        hold_gain: rate at which held directions come back to the goal's, 1/s.
        held_from, held_fully: turn of the camera per unit of joint, rad, from which a held
            direction counts, and from which it counts in full.
        reach_bend: bend of an elbow at which the Jacobian is taken to come back from straight, rad.
        shortfall: missing speed of the camera that is worth a word, m/s.
        lost_part: part of what was asked that has to be missing for it.
    """

    length: float = 0.1
    damping: float = 0.003
    damping_below: float = 0.012
    hold_gain: float = 3.0
    held_from: float = 0.05
    held_fully: float = 0.2
    reach_bend: float = 0.05
    shortfall: float = 0.002
    lost_part: float = 0.1

_NOTHING_HELD = np.zeros((0, 6)), np.zeros(0), np.eye(6)


class _Demand(NamedTuple):
    """What is asked of the camera's scaled twist.

    Attributes:
        basis: (m, 6) orthonormal directions.
        wanted: (m,) speeds along them, m/s.
        weights: (m,) of each, 0 to 1, where the arm has to choose.
    """

    basis: np.ndarray
    wanted: np.ndarray
    weights: np.ndarray


class Resolver:
    """Inverts what a task asks of an arm, with respect for singularities, limits, other tasks.

    Attributes:
        goal: `reference_T_camera` (4, 4) whose attitude and place the directions that a task does
            not model are held at; None: where the camera is when first asked after a reset.
    """

    def __init__(
        self,
        arm: Arm,
        limits: Limits | None = None,
        tasks: Sequence[SecondaryTask] = (),
        settings: ResolverSettings | None = None,
        folds: Sequence[Fold] | None = None,
    ) -> None:
        """`folds`: elbows that may stretch; None: those found in the arm."""
        self.arm = arm
        self.limits = limits if limits is not None else Limits.of(arm)
        self.tasks = tuple(tasks)
        self.settings = settings if settings is not None else ResolverSettings()
        self.folds = tuple(find(arm) if folds is None else folds)
        self.goal: np.ndarray | None = None
        self._scale = np.array([1.0] * 3 + [self.settings.length] * 3)
        self._bounds = Bounds(self.limits)
        self.reset()

    def reset(self) -> None:
        """Forget the last velocities, and where the camera was when first asked."""
        self._kept: np.ndarray | None = None
        self._bounds.reset()

    def resolve(
        self, q: np.ndarray, task: Task, dt: float, previous: np.ndarray | None = None
    ) -> Resolution:
        """Joint velocities for a task at a posture.

        Args:
            q: (n,) joints, rad or m.
            task: with L (k, 6), rate (k,) and modelled (6,).
            dt: for which the velocities will be commanded, s; 0: only speeds are limited.
            previous: (n,) velocities commanded before, for the limits of acceleration.

        Raises:
            ValueError: something given is not finite, or of a wrong shape.
            numpy.linalg.LinAlgError: the Jacobian is not finite.
        """
        q, dt = np.asarray(q, float), float(dt)
        L, rate = task.L, task.rate
        if not math.isfinite(np.vdot(q, q) + np.vdot(L, L) + np.vdot(rate, rate) + dt):
            raise ValueError(f"resolver: not finite: joints {q}, rate {rate}, L {L}, dt {dt}")
        view, jacobian = self.arm.view(q)
        scaled = self._scale[:, None] * jacobian
        demand = self._demand(task, view, scaled)
        wish = np.zeros(len(q))
        for entry in self.tasks:
            wish += entry.velocity(q)

        low, high = self._bounds.positions(q, dt)
        free, fixed = np.ones(len(q), bool), np.zeros(len(q))
        stopped: list[int] = []
        straight = False
        for _ in range(len(q) + 1):
            solution, secondary = self._either_side(q, scaled, demand, wish, free, fixed)
            passing = [fold for fold in self.folds if self._passes(fold, q, solution, dt, free)]
            for fold in passing:
                fixed[fold.joint] = -0.5 * fold.bend(q) / dt
                free[fold.joint], straight = False, True
            if passing:
                continue
            within = np.minimum(np.maximum(solution, low), high)
            beyond = (within != solution) & free
            if not beyond.any():
                break
            fixed[beyond] = within[beyond]
            free &= ~beyond
            stopped += np.flatnonzero(beyond).tolist()

        velocities, primary, scale, slowest = self._bounds.apply(
            solution, secondary, low, high, dt, previous
        )
        asked, twist, lost = account(
            demand.basis, demand.wanted, scaled, jacobian, self._scale, solution, velocities
        )
        names = self.arm.names
        steady = not (stopped or straight or slowest is not None)
        reasons = self._reasons(asked, lost, stopped, straight)
        if slowest is not None:
            reasons.append(f"slowed to {100.0 * scale:.0f} % for a limit of {names[slowest]}")
        return Resolution(
            velocities=velocities,
            primary=primary,
            asked=asked,
            twist=twist,
            lost=lost,
            scale=scale,
            margins=self.limits.margins(q),
            stopped=tuple(names[joint] for joint in stopped),
            slowing="" if slowest is None else names[slowest],
            reasons=tuple(reasons),
            L=L,
            jacobian=jacobian,
            modelled=task.modelled,
            lasts=LASTING if steady and self._steady(q, velocities, free) else 0.0,
        )

    def _steady(self, q: np.ndarray, velocities: np.ndarray, free: np.ndarray) -> bool:
        """Whether velocities (n,) stay right for LASTING: the posture hardly changes, and no limit
        and no elbow asks for others."""
        if max(map(abs, velocities.tolist())) * LASTING > STILL:
            return False
        if not self._bounds.allow(q, velocities, LASTING):
            return False
        return not any(self._passes(fold, q, velocities, LASTING, free) for fold in self.folds)

    def _demand(self, task: Task, view: np.ndarray, scaled: np.ndarray) -> _Demand:
        """What the task asks for, and the holding of what it does not model."""
        settings, length, modelled = self.settings, self.settings.length, task.modelled
        if modelled.all():
            held, errors, free = _NOTHING_HELD
        else:
            if self._kept is None:
                self._kept = view
            goal = self.goal if self.goal is not None else self._kept
            holding = Held(view, goal, modelled, length)
            held, errors, free = holding.rows, holding.errors, holding.free
        return _Demand(*demanded(
            task.L / self._scale, task.rate, held, settings.hold_gain * errors, free, scaled,
            length * settings.held_from, length * settings.held_fully,
        ))  # fmt: skip

    def _either_side(
        self,
        q: np.ndarray,
        scaled: np.ndarray,
        demand: _Demand,
        wish: np.ndarray,
        free: np.ndarray,
        fixed: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Solve at q, or with slightly bent elbows when that is the way back from straight."""
        bend = self.settings.reach_bend
        near = [fold for fold in self.folds if abs(fold.bend(q)) < bend and free[fold.joint]]
        if near:
            bent = q
            for fold in near:
                bent = fold.bent(bent, fold.side_of(q) * bend - fold.bend(q))
            there = self._scale[:, None] * self.arm.jacobian(bent)
            answer = self._solve(there, demand, wish, free, fixed)
            if all(answer[0][fold.joint] * fold.side_of(q) > 0.0 for fold in near):
                return answer
        return self._solve(scaled, demand, wish, free, fixed)

    def _solve(
        self,
        scaled: np.ndarray,
        demand: _Demand,
        wish: np.ndarray,
        free: np.ndarray,
        fixed: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Velocities (n,) for the demand, the others at their fixed ones, and what is free."""
        settings = self.settings
        return solved(
            scaled, *demand, wish, free, fixed, settings.damping, settings.damping_below
        )

    def _passes(
        self, fold: Fold, q: np.ndarray, velocities: np.ndarray, dt: float, free: np.ndarray
    ) -> bool:
        """Whether this step would take more than half of an elbow's small bend away."""
        bend, speed = fold.bend(q), float(velocities[fold.joint])
        near = abs(bend) < self.settings.reach_bend and bool(free[fold.joint])
        return near and speed * fold.side_of(q) < 0.0 and abs(speed) * dt > 0.5 * abs(bend)

    def _reasons(
        self, asked: np.ndarray, lost: np.ndarray, stopped: Sequence[int], straight: bool
    ) -> list[str]:
        """What keeps the camera from what is asked of it, in words."""
        reasons = [f"{self.arm.names[joint]} stopped at its limit" for joint in stopped]
        missing = (lost * self._scale).tolist()
        wanted = math.hypot(*(asked * self._scale).tolist())
        if math.hypot(*missing) <= max(self.settings.shortfall, self.settings.lost_part * wanted):
            return reasons
        if straight:
            reasons.append("the arm is stretched: what is asked lies beyond its reach")
        elif not stopped:
            most = max(map(abs, missing))
            main = [i for i, part in enumerate(missing) if abs(part) > 0.5 * most]
            reasons.append(
                "lost, the arm cannot do it here: "
                + ", ".join(f"{DIRECTIONS[i]} {lost[i]:.3g} {UNITS[i]}" for i in main)
            )
        return reasons
