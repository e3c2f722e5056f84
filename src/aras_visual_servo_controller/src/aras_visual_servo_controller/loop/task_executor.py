"""What the arm pursues between images: the last decision's task, or a controller of its own."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from ..kinematics.differential_ik import solve_ik
from ..kinematics.joint_sample import JointSample
from ..kinematics.task import Task
from ..records.state import ServoSettings
from ..schemes.base import JointController, Scheme
from ..schemes.output_checks import check_joint_output
from ..schemes.time_limit import call_user_code
from .command_integrator import CommandIntegrator

if TYPE_CHECKING:
    from ..kinematics.differential_ik import DifferentialIK
    from ..kinematics.ik_solution import IKSolution


ROUNDING = 1e-12  # s


class TaskExecutor:
    """Joint velocities for what was asked last.

    Attributes:
        task: that is resolved now; None: none is, or the scheme answers joints itself.
        controlled: whether it does, and may.
        pending: tasks that wait for the delay to be over, with the time when it is, s.
        kept: when velocities (n,) were worked out, those, how long they last, s, and what holds
            them back, in words; None: they have to be.
    """

    def __init__(
        self,
        name: str,
        scheme: Scheme | JointController,
        differential_ik: DifferentialIK,
        integrator: CommandIntegrator,
        settings: ServoSettings,
    ) -> None:
        """`name`: of the scheme, for messages; `motion`: where the commands stand."""
        self.name, self.scheme, self.differential_ik = name, scheme, differential_ik
        self.integrator, self.settings = integrator, settings
        self.clear()

    def clear(self) -> None:
        """Nothing is asked of the arm any more."""
        self.task: Task | None = None
        self.is_joint_controlled = False
        self.pending_tasks: deque[tuple[float, Task]] = deque()
        self.cached_velocities: tuple[float, np.ndarray, float, str] | None = None

    def set_task(
        self, task: Task | None, solution: IKSolution | None, stamp: float, now: float | None
    ) -> None:
        """Take up what an image's decision asks for, at once or after the delay.

        Args:
            task: None: the scheme answers joints itself.
            resolution: of the task; kept as long as it lasts.
            stamp: of the image, s. now: of the last tick, s; None before the first.
        """
        if task is None:
            self.is_joint_controlled = True
        elif self.settings.delay > 0.0:
            self.pending_tasks.append((stamp + self.settings.delay, task))
        else:
            self.task, self.cached_velocities = task, None
            if solution is not None and solution.reuse_time > 0.0 and now is not None:
                reasons = "; ".join(solution.reasons)
                self.cached_velocities = now, solution.velocities, solution.reuse_time, reasons

    def activate_pending(self, t: float) -> None:
        """Have the tasks whose delay is over at t (s) count."""
        while self.pending_tasks and self.pending_tasks[0][0] <= t + ROUNDING:
            self.task, self.cached_velocities = self.pending_tasks.popleft()[1], None

    def compute_velocities(
        self, t: float, dt: float, measured: JointSample, start_stamp: float
    ) -> tuple[np.ndarray, str] | None:
        """Joint velocities (n,) and what holds them back, in words; None: nothing is asked.

        Args:
            t, dt: of this tick, and since the last one, s.
            measured: joints. began: when servoing did, s.

        Raises:
            SchemeError: a controller's own fault. ServoError: no velocities come of it.
        """
        if self.is_joint_controlled:
            return self._update_controller(t - start_stamp, dt, measured)
        if self.task is None:
            return None
        period = self.settings.resolve_period
        kept = self.cached_velocities
        if kept is None or t - kept[0] >= max(kept[2], period) - 1e-9:
            found = solve_ik(
                self.task,
                measured.positions,
                self.differential_ik,
                max(dt, period),
                self.integrator.velocity,
            )
            kept = self.cached_velocities = (
                t,
                found.velocities,
                found.reuse_time,
                "; ".join(found.reasons),
            )
        return kept[1], kept[3]

    def _update_controller(
        self, t: float, dt: float, measured: JointSample
    ) -> tuple[np.ndarray, str]:
        """Velocities (n,) of a controller that answers joints, within the limits."""
        answer = call_user_code(
            self.scheme.update, t, dt, measured, limit=self.settings.scheme_timeout,
            scheme=self.name,
        )  # fmt: skip
        answer = check_joint_output(self.name, answer, len(self.integrator.names))
        if self.scheme.output == "position":
            velocities = np.zeros_like(answer)
            if dt > 0.0:
                velocities = (answer - self.integrator.command) / dt
        elif self.scheme.output == "acceleration":
            velocities = self.integrator.velocity + answer * dt
        else:
            velocities = answer
        return self.integrator.limit_velocities(velocities, dt)
