"""Execution of the present task, or of a joint controller, between images."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from ..kinematics.differential_ik import solve_ik
from ..kinematics.joint_sample import JointSample
from ..kinematics.task import Task
from ..records.state import ServoSettings
from ..schemes.base import JointController, Scheme
from ..schemes.scheme_call import check_joint_output
from ..schemes.time_limit import call_user_code
from .command_integrator import CommandIntegrator

if TYPE_CHECKING:
    from ..kinematics.differential_ik import DifferentialIK
    from ..kinematics.ik_solution import IKSolution


ROUNDING = 1e-12  # rounding error of times, s


class TaskExecutor:
    """Source of the joint velocities between images.

    Attributes:
        task: task that is executed; None if there is none, or if the scheme commands joints itself.
        is_joint_controlled: whether the scheme commands joints itself.
        pending_tasks: tasks that wait until the time `delay` since their exposure is over, each
            with the time at which it starts, s.
        cached_velocities: latest solution of the inverse kinematics: time at which it was computed,
            s; velocities (n,); time for which they are valid, s; what limits them, as text. None if
            there is no solution for the present task.
    """

    def __init__(
        self,
        name: str,
        scheme: Scheme | JointController,
        differential_ik: DifferentialIK,
        integrator: CommandIntegrator,
        settings: ServoSettings,
    ) -> None:
        """Create the executor.

        Args:
            name: name of the scheme, for messages.
            integrator: integrator of the commands.
        """
        self.name, self.scheme, self.differential_ik = name, scheme, differential_ik
        self.integrator, self.settings = integrator, settings
        self.clear()

    def clear(self) -> None:
        """Remove the present task and all pending tasks."""
        self.task: Task | None = None
        self.is_joint_controlled = False
        self.pending_tasks: deque[tuple[float, Task]] = deque()
        self.cached_velocities: tuple[float, np.ndarray, float, str] | None = None

    def set_task(
        self, task: Task | None, solution: IKSolution | None, stamp: float, now: float | None
    ) -> None:
        """Set the task of an image; it starts at once, or `ServoSettings.delay` after the exposure.

        Args:
            task: task of the image; None if the scheme commands joints itself.
            solution: joint velocities for the task, which are used as long as they are valid.
            stamp: stamp of the image, s.
            now: time of the last update, s; None before the first update.
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
        """Start the pending tasks whose delay has passed at the time t (s)."""
        while self.pending_tasks and self.pending_tasks[0][0] <= t + ROUNDING:
            self.task, self.cached_velocities = self.pending_tasks.popleft()[1], None

    def compute_velocities(
        self, t: float, dt: float, measured: JointSample, start_stamp: float
    ) -> tuple[np.ndarray, str] | None:
        """Compute joint velocities (n,), and describe what limits them.

        Return None if there is no task.

        Args:
            t: time of this update, s.
            dt: time since the last update, s.
            measured: joint sample of this update.
            start_stamp: time at which servoing started, s.

        Raises:
            SchemeError: the scheme's joint controller failed.
            ServoError: no velocities can be computed.
        """
        if self.is_joint_controlled:
            return self._update_controller(t - start_stamp, dt, measured)
        if self.task is None:
            return None
        period = self.settings.resolve_period
        cached = self.cached_velocities
        if cached is None or t - cached[0] >= max(cached[2], period) - 1e-9:
            found = solve_ik(
                self.task,
                measured.positions,
                self.differential_ik,
                max(dt, period),
                self.integrator.velocity,
            )
            cached = self.cached_velocities = (
                t,
                found.velocities,
                found.reuse_time,
                "; ".join(found.reasons),
            )
        return cached[1], cached[3]

    def _update_controller(
        self, t: float, dt: float, measured: JointSample
    ) -> tuple[np.ndarray, str]:
        """Return the velocities (n,) of a scheme that commands joints, and what limits them."""
        output = call_user_code(
            self.scheme.update, t, dt, measured, limit=self.settings.scheme_timeout,
            scheme=self.name,
        )  # fmt: skip
        output = check_joint_output(self.name, output, len(self.integrator.names))
        if self.scheme.output == "position":
            velocities = np.zeros_like(output)
            if dt > 0.0:
                velocities = (output - self.integrator.command) / dt
        elif self.scheme.output == "acceleration":
            velocities = self.integrator.velocity + output * dt
        else:
            velocities = output
        return self.integrator.limit_velocities(velocities, dt)
