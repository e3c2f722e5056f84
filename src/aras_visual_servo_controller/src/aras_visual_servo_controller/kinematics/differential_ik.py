"""Differential inverse kinematics: from a task to joint velocities.

Let L be the task's interaction matrix, J the arm's Jacobian, and H the matrix of the camera
directions that the task does not control. The joint velocities q_dot are the least-squares solution
of

    L J q_dot = e_dot        H J q_dot = hold_gain (goal - now)

where twists are scaled so that 1 rad has the weight of a length. The second equation moves the
camera back to the goal in the directions H.

Damping: near a singularity of the arm, joint motions that hardly move the camera (those with small
singular values of J) are damped by additional rows of the equations. All other motions are exact
(Nakamura and Hanafusa 1986; damping of single directions: Maciejewski and Klein 1988). If the arm
can hardly move the camera along a direction of H, this direction gets a smaller weight.

Secondary tasks: the sum z of their velocities is projected, q_dot += (I - A^+ T) z, where T
contains the rows of both equations, and A the same rows and those of the damping.

Limits: a joint at the end of its range stops, and the other joints perform the task as well as
possible. Speed and acceleration limits scale the task without changing its direction. The secondary
tasks get the remaining speed.

Stretched elbows (see `elbow.py`) cannot move the camera along the arm to first order:

- An elbow that is being stretched never passes its straight position: one step removes at most half
  of the remaining bend.
- To bend a straight elbow, J is computed for an elbow that is bent by `reach_bend`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..errors import ServoError
from .algebra import is_finite
from .arm import Arm
from .chain import NO_JOINTS
from .command_limits import CommandLimits
from .compiled_ik import PRIMARY, REUSE_TIME, solve_velocities
from .elbow import Elbow, find_elbows
from .ik_solution import IKSolution
from .task import DIRECTIONS, UNITS

if TYPE_CHECKING:
    from .secondary_tasks import SecondaryTask
    from .task import Task


@dataclass(frozen=True)
class IKSettings:
    """Parameters of the inverse kinematics; the defaults are for an arm.

    Attributes:
        length: length that has the same weight as 1 rad of camera rotation, m.
        damping: maximum damping, m per rad or m of joint motion.
        damping_below: singular value of J below which a joint motion is damped, in the unit of
            `damping`.
        hold_gain: rate at which held directions return to the goal, 1/s.
        hold_onset: camera rotation (rad) per rad or m of joint motion. A held direction in which
            the arm moves the camera less than this is not controlled.
        hold_full: the same quantity, above which a held direction has its full weight; between
            `hold_onset` and `hold_full`, the weight rises from 0 to 1.
        reach_bend: bend of the elbow for which J is computed when a straight elbow is to be bent,
            rad.
        reported_speed: smallest infeasible part of the desired twist that is reported, m/s.
        reported_part: smallest infeasible part that is reported, as a fraction of the desired
            twist.
        prismatic_unit: motion of a prismatic joint that has the same weight as 1 rad of a revolute
            joint, m.
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
        """Return the parameters for a free-flying camera, which has no singularities.

        Args:
            depth: depth of the target, which scales all lengths, m.
            hold_gain: rate at which held directions return to the goal, 1/s.
        """
        return cls(
            length=depth, damping=0.0, damping_below=0.0, hold_gain=hold_gain, hold_onset=0.0,
            hold_full=1e-9, reported_speed=0.01 * depth, prismatic_unit=depth,
        )  # fmt: skip


class DifferentialIK:
    """Differential inverse kinematics of an arm, with limits, damping and secondary tasks.

    It solves L J q_dot = e_dot in the least-squares sense for the joint velocities q_dot (n,), in
    rad/s or m/s. The camera is held at the goal in directions that the task does not control. Weak
    motions of a nearly singular arm are damped. Equations and sources are in the docstring of this
    module.

    Attributes:
        goal: `reference_T_camera` (4, 4), the pose at which the camera is held in directions that a
            task does not control; None for its pose at the first call of `solve` after a reset.
        other_tasks: secondary tasks that are not a JointRangeTask.
        setting_values, limit_rows, has_acceleration_limits, elbow_rows, range_tasks,
            last_velocities: inputs of the compiled function `solve_velocities`.
    """

    def __init__(
        self,
        arm: Arm,
        limits: CommandLimits | None = None,
        tasks: Sequence[SecondaryTask] = (),
        settings: IKSettings | None = None,
        elbows: Sequence[Elbow] | None = None,
    ) -> None:
        """Prepare the inverse kinematics of one arm.

        Args:
            arm: arm that provides pose and Jacobian of the camera.
            limits: limits of position, speed and acceleration; None for those of the robot
                description.
            tasks: secondary tasks, which use the redundancy of the arm.
            settings: parameters; None for the defaults, which suit an arm of usual size.
            elbows: elbows that can stretch; None to search for them in the arm.
        """
        self.arm = arm
        self.limits = limits if limits is not None else CommandLimits.for_arm(arm)
        self.tasks = tuple(tasks)
        self.settings = settings if settings is not None else IKSettings()
        self.elbows = tuple(find_elbows(arm) if elbows is None else elbows)
        self.goal: np.ndarray | None = None
        self._scale = np.array([1.0] * 3 + [self.settings.length] * 3)
        self.setting_values = np.array(list(vars(self.settings).values()))
        units = np.where(arm.is_prismatic, self.settings.prismatic_unit, 1.0)
        bounds = self.limits
        self.limit_rows = np.array([
            bounds.lower, bounds.upper, bounds.velocity, bounds.acceleration, units,
        ], float)  # fmt: skip
        self.has_acceleration_limits = bool(np.isfinite(bounds.acceleration).any())
        self.elbow_rows = np.array([list(vars(elbow).values()) for elbow in self.elbows], float)
        self.elbow_rows = self.elbow_rows.reshape(-1, 7)
        range_tasks: list[JointRangeTask] = []
        if self.tasks:
            from .secondary_tasks import JointRangeTask

            range_tasks = [
                task for task in self.tasks if type(task).velocity is JointRangeTask.velocity
            ]
        self.range_tasks = np.array([task.rows for task in range_tasks]).reshape(
            -1, 3, len(arm.names)
        )
        self.other_tasks = [task for task in self.tasks if task not in range_tasks]
        self.reset()

    def reset(self) -> None:
        """Forget the last velocities and the camera pose at which uncontrolled directions are held.
        """
        self._cached_view: np.ndarray | None = None
        # Last joint velocities, and the part of them that executes the task; NaN before the first
        # solution.
        self.last_velocities = np.full((2, len(self.arm.names)), np.nan)

    def solve(
        self, q: np.ndarray, task: Task, dt: float, previous: np.ndarray | None = None
    ) -> IKSolution:
        """Compute the joint velocities for a task.

        Args:
            q: (n,) joint positions, rad or m.
            task: task with L (k, 6), desired_rate (k,) and modelled (6,).
            dt: time for which the velocities will be commanded, s; if it is 0, only the speed
                limits apply.
            previous: (n,) velocities that were commanded before, for the acceleration limits.

        Raises:
            ValueError: an input is not finite, or has a wrong shape.
            numpy.linalg.LinAlgError: the Jacobian is not finite.
        """
        q, dt = np.asarray(q, float), float(dt)
        if not (is_finite(q) and math.isfinite(dt)):
            raise ValueError(f"inverse kinematics: joints {q} or dt {dt} are not finite")
        count, preferred = len(q), np.zeros(len(q))
        for entry in self.other_tasks:
            preferred += entry.velocity(q)
        limited = previous is not None and self.has_acceleration_limits and dt > 0.0
        before = np.asarray(previous, float) if limited else q
        goal = self._find_hold_pose(q, task.modelled) if self.goal is None else self.goal
        inputs = (
            goal, task.L, task.desired_rate, task.modelled, preferred, self.range_tasks,
            self.elbow_rows, self.limit_rows, dt, limited, before, self.last_velocities,
            self.setting_values,
        )  # fmt: skip
        chain, view = getattr(self.arm, "chain", None), (np.empty((4, 4)), np.empty((6, count)))
        if chain is None:
            chain, view = NO_JOINTS, tuple(map(np.array, self.arm.pose_and_jacobian(q)))
        joints, twists = np.empty((4, count)), np.empty((3, 6))
        scale, slowest, straight, is_reported, reusable, stop_count = solve_velocities(
            *chain, q, *view, *inputs, joints, twists
        )
        velocities, primary, margins, stopped = joints
        desired, achieved, infeasible = twists
        self.last_velocities[:] = joints[: PRIMARY + 1]
        names, reasons, limiting = (), [], ""
        if stop_count:
            names = tuple(self.arm.names[joint] for joint in np.flatnonzero(stopped))
            reasons = [f"{name} stopped at its limit" for name in names]
        if is_reported:
            reasons += self._explain_infeasible(infeasible, bool(names), straight)
        if slowest >= 0:
            limiting = self.arm.names[slowest]
            reasons.append(f"velocity scaled to {100.0 * scale:.0f} % (limit of {limiting})")
        return IKSolution(
            velocities, primary, desired, achieved, infeasible, scale, margins, names,
            limiting, tuple(reasons), task.L, view[1], task.modelled,
            REUSE_TIME if reusable else 0.0,
        )  # fmt: skip

    def _find_hold_pose(self, q: np.ndarray, modelled: np.ndarray) -> np.ndarray:
        """Return the pose that is used if `goal` is None.

        It is the camera pose at the first call after a reset with uncontrolled directions.
        """
        if self._cached_view is not None:
            return self._cached_view
        view = self.arm.pose_and_jacobian(q)[0]
        if not modelled.all():
            self._cached_view = view
        return view

    def _explain_infeasible(
        self, infeasible_twist: np.ndarray, is_stopped: bool, is_straight: bool
    ) -> list[str]:
        """Explain as text why a part of the desired twist is infeasible."""
        if is_straight:
            return ["the arm is stretched: the commanded motion leads beyond its reach"]
        if is_stopped:
            # The reason of the run's outcome already names the joint that is at its limit.
            return []
        missing = np.abs(infeasible_twist * self._scale)
        main = np.flatnonzero(missing > 0.5 * missing.max())
        words = ", ".join(f"{DIRECTIONS[i]} {infeasible_twist[i]:.3g} {UNITS[i]}" for i in main)
        return [f"the arm cannot produce this motion here: {words}"]


def solve_ik(
    task: Task,
    q: np.ndarray,
    differential_ik: DifferentialIK,
    period: float = 0.0,
    velocities: np.ndarray | None = None,
) -> IKSolution:
    """Compute the joint velocities q_dot for the camera motion of a task: L J q_dot = e_dot.

    Args:
        task: task with L (k, 6) and the desired rate e_dot (k,) of the error.
        q: (n,) joint positions, rad or m.
        differential_ik: inverse kinematics of the arm, with limits and secondary tasks.
        period: time for which the velocities will be commanded, s; 0 if it is unknown.
        velocities: (n,) velocities that were commanded before, for the acceleration limits.

    Returns:
        The solution, with velocities (n,) in rad/s or m/s. Camera directions that the features do
        not measure accurately enough are not part of the task.

    Raises:
        ServoError: the velocities are not finite.
        ValueError: an input is not finite.
    """
    measurable = task if task.is_exact else task.measurable_task
    solution = differential_ik.solve(q, measurable, period, velocities)
    if not is_finite(solution.velocities):
        raise ServoError("the joint velocities are not finite")
    return solution
