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
from dataclasses import astuple, dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..errors import ServoError
from .algebra import are_finite
from .arm import Arm
from .chain import NO_JOINTS
from .compiled_ik import REUSE_TIME, solve_velocities
from .elbow import Elbow, find_elbows
from .ik_solution import IKSolution
from .limits import Limits
from .task import DIRECTIONS, UNITS

if TYPE_CHECKING:
    from .secondary_tasks import SecondaryTask
    from .task import Task


@dataclass(frozen=True)
class IKSettings:
    """Numbers of the resolver: those of an arm, or `for_free_camera`.

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
        slide: m that a sliding joint moves while one that turns moves by a radian.
    """

    length: float = 0.1
    damping: float = 0.003
    damping_below: float = 0.012
    hold_gain: float = 3.0
    hold_onset: float = 0.05
    hold_full: float = 0.2
    reach_bend: float = 0.05
    reported_speed: float = 0.002
    reported_part: float = 0.1
    prismatic_unit: float = 1.0

    @classmethod
    def for_free_camera(cls, depth: float, hold_gain: float) -> IKSettings:
        """Those of a camera that flies: it has no singularities, and its lengths are the scene's.

        `depth`: of the target, m.
        """
        return cls(
            length=depth, damping=0.0, damping_below=0.0, hold_gain=hold_gain, hold_onset=0.0,
            hold_full=1e-9, reported_speed=0.01 * depth, prismatic_unit=depth,
        )  # fmt: skip


class DifferentialIK:
    """Inverts what a task asks of an arm, with respect for singularities, limits, other tasks.

    Solves L J q_dot = e_dot in the least-squares sense for the joint velocities q_dot (n,), in
    rad/s or m/s; directions that the task does not model are held as at the goal. Weak motions of
    a nearly singular arm are damped. Equations and sources are at the head of this file.

    Attributes:
        goal: `reference_T_camera` (4, 4) whose attitude and place the directions that a task does
            not model are held at; None: where the camera is when first asked after a reset.
        others: secondary tasks that are no Pull.
        numbers, limit_rows, accelerates, fold_rows, pulls, last: as `resolved` takes them.
    """

    def __init__(
        self,
        arm: Arm,
        limits: Limits | None = None,
        tasks: Sequence[SecondaryTask] = (),
        settings: IKSettings | None = None,
        elbows: Sequence[Elbow] | None = None,
    ) -> None:
        """Prepare the inversion for one arm.

        Args:
            arm: pose and Jacobian of the camera.
            limits: of position, speed and acceleration; None: those of the arm's description.
            tasks: secondary tasks, which get the freedom that the camera's task leaves.
            settings: damping, and gain of what is held; None: those of an arm of the usual size.
            folds: elbows that may stretch; None: those found in the arm.
        """
        self.arm = arm
        self.limits = limits if limits is not None else Limits.for_arm(arm)
        self.tasks = tuple(tasks)
        self.settings = settings if settings is not None else IKSettings()
        self.elbows = tuple(find_elbows(arm) if elbows is None else elbows)
        self.goal: np.ndarray | None = None
        self._scale = np.array([1.0] * 3 + [self.settings.length] * 3)
        self.setting_values = np.array(astuple(self.settings))
        units = np.where(arm.is_prismatic, self.settings.prismatic_unit, 1.0)
        self.limit_rows = np.array([*astuple(self.limits)[1:], units], float)
        self.has_acceleration_limits = bool(np.isfinite(self.limits.acceleration).any())
        self.elbow_rows = np.array([astuple(fold) for fold in self.elbows], float).reshape(-1, 7)
        pulls: list[JointRangeTask] = []
        if self.tasks:
            from .secondary_tasks import JointRangeTask

            pulls = [task for task in self.tasks if type(task).velocity is JointRangeTask.velocity]
        self.range_tasks = np.array([task.rows for task in pulls]).reshape(-1, 3, len(arm.names))
        self.other_tasks = [task for task in self.tasks if task not in pulls]
        self.reset()

    def reset(self) -> None:
        """Forget the last velocities, and where the camera was when first asked."""
        self._cached_view: np.ndarray | None = None
        # The last velocities, and their part for the task; none yet.
        self.last_velocities = np.full((2, len(self.arm.names)), np.nan)

    def solve(
        self, q: np.ndarray, task: Task, dt: float, previous: np.ndarray | None = None
    ) -> IKSolution:
        """Compute the joint velocities for a task at a posture.

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
        if not (are_finite(q, q, q) and math.isfinite(dt)):
            raise ValueError(f"resolver: not finite: joints {q}, dt {dt}")
        wish = np.zeros(len(q))
        for entry in self.other_tasks:
            wish += entry.velocity(q)
        limited = previous is not None and self.has_acceleration_limits and dt > 0.0
        before = np.asarray(previous, float) if limited else q
        goal = self._find_hold_pose(q, task.modelled) if self.goal is None else self.goal
        asked = (
            goal, task.L, task.desired_rate, task.modelled, wish, self.range_tasks, self.elbow_rows,
            self.limit_rows, dt, limited, before, self.last_velocities, self.setting_values,
        )  # fmt: skip
        chain, view = getattr(self.arm, "chain", None), (np.empty((4, 4)), np.empty((6, len(q))))
        if chain is None:
            chain, view = NO_JOINTS, tuple(map(np.array, self.arm.pose_and_jacobian(q)))
        found = solve_velocities(*chain, q, *view, *asked)
        velocities, primary, asked, twist, lost, scale = found[:6]
        slowest, stopped, straight, short, lasts, margins = found[6:]
        self.last_velocities[:] = velocities, primary
        names = [self.arm.names[joint] for joint in stopped]
        reasons = [f"{name} stopped at its limit" for name in names]
        if short:
            reasons += self._explain_infeasible(lost, bool(names), straight)
        slowing = "" if slowest < 0 else self.arm.names[slowest]
        if slowing:
            reasons.append(f"slowed to {100.0 * scale:.0f} % for a limit of {slowing}")
        return IKSolution(
            velocities, primary, asked, twist, lost, scale, margins, tuple(names), slowing,
            tuple(reasons), task.L, view[1], task.modelled, REUSE_TIME if lasts else 0.0,
        )  # fmt: skip

    def _find_hold_pose(self, q: np.ndarray, modelled: np.ndarray) -> np.ndarray:
        """What `goal` stands for where it is not given."""
        if self._cached_view is not None:
            return self._cached_view
        view = self.arm.pose_and_jacobian(q)[0]
        if not modelled.all():
            self._cached_view = view
        return view

    def _explain_infeasible(
        self, infeasible_twist: np.ndarray, is_stopped: bool, is_straight: bool
    ) -> list[str]:
        """Why a twist (6,) that is asked of the camera cannot be had, in words."""
        if is_straight:
            return ["the arm is stretched: what is asked lies beyond its reach"]
        if is_stopped:
            return []  # the limit that stops a joint has been named
        missing = np.abs(infeasible_twist * self._scale)
        main = np.flatnonzero(missing > 0.5 * missing.max())
        words = ", ".join(f"{DIRECTIONS[i]} {infeasible_twist[i]:.3g} {UNITS[i]}" for i in main)
        return [f"lost, the arm cannot do it here: {words}"]


def solve_ik(
    task: Task,
    q: np.ndarray,
    differential_ik: DifferentialIK,
    period: float = 0.0,
    velocities: np.ndarray | None = None,
) -> IKSolution:
    """Joint velocities that give the camera the motion which a task asks for: L J q_dot = e_dot.

    Args:
        task: L (k, 6) and the desired rate (k,) of the error.
        q: (n,) joints, rad or m.
        resolver: of the arm, with its limits and secondary tasks.
        period: for which the velocities will be commanded, s; 0: not known.
        velocities: (n,) commanded before, for the limits of acceleration.

    Returns:
        The solution, with velocities (n,) in rad/s or m/s; of the task without the directions that
        no feature shows.

    Raises:
        ServoError: the velocities are not finite. ValueError: an input is not.
    """
    solution = differential_ik.solve(q, task.measurable_task, period, velocities)
    if not are_finite(solution.velocities, solution.velocities, solution.velocities):
        raise ServoError("the joint velocities are not finite")
    return solution
