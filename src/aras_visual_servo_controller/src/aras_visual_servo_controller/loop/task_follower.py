"""What the arm pursues between images: the last decision's task, or a controller of its own."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from ..arm.joint_sample import JointSample
from ..arm.resolver import solve_ik
from ..arm.task import Task
from ..records.state import ServoSettings
from ..schemes.answer_checks import checked_joints
from ..schemes.base import JointController, Scheme
from ..schemes.time_limit import call_user_code
from .motion import CommandMotion

if TYPE_CHECKING:
    from ..arm.resolution import Resolution
    from ..arm.resolver import Resolver


ROUNDING = 1e-12  # s


class Pursuit:
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
        resolver: Resolver,
        motion: CommandMotion,
        settings: ServoSettings,
    ) -> None:
        """`name`: of the scheme, for messages; `motion`: where the commands stand."""
        self.name, self.scheme, self.resolver = name, scheme, resolver
        self.motion, self.settings = motion, settings
        self.drop()

    def drop(self) -> None:
        """Nothing is asked of the arm any more."""
        self.task: Task | None = None
        self.controlled = False
        self.pending: deque[tuple[float, Task]] = deque()
        self.kept: tuple[float, np.ndarray, float, str] | None = None

    def ask(
        self, task: Task | None, resolution: Resolution | None, stamp: float, now: float | None
    ) -> None:
        """Take up what an image's decision asks for, at once or after the delay.

        Args:
            task: None: the scheme answers joints itself.
            resolution: of the task; kept as long as it lasts.
            stamp: of the image, s. now: of the last tick, s; None before the first.
        """
        if task is None:
            self.controlled = True
        elif self.settings.delay > 0.0:
            self.pending.append((stamp + self.settings.delay, task))
        else:
            self.task, self.kept = task, None
            if resolution is not None and resolution.lasts > 0.0 and now is not None:
                reasons = "; ".join(resolution.reasons)
                self.kept = now, resolution.velocities, resolution.lasts, reasons

    def take_up(self, t: float) -> None:
        """Have the tasks whose delay is over at t (s) count."""
        while self.pending and self.pending[0][0] <= t + ROUNDING:
            self.task, self.kept = self.pending.popleft()[1], None

    def velocities(
        self, t: float, dt: float, measured: JointSample, began: float
    ) -> tuple[np.ndarray, str] | None:
        """Joint velocities (n,) and what holds them back, in words; None: nothing is asked.

        Args:
            t, dt: of this tick, and since the last one, s.
            measured: joints. began: when servoing did, s.

        Raises:
            SchemeError: a controller's own fault. ServoError: no velocities come of it.
        """
        if self.controlled:
            return self._of_controller(t - began, dt, measured)
        if self.task is None:
            return None
        period = self.settings.resolve_period
        kept = self.kept
        if kept is None or t - kept[0] >= max(kept[2], period) - 1e-9:
            found = solve_ik(
                self.task, measured.positions, self.resolver, max(dt, period), self.motion.velocity
            )
            kept = self.kept = t, found.velocities, found.lasts, "; ".join(found.reasons)
        return kept[1], kept[3]

    def _of_controller(
        self, t: float, dt: float, measured: JointSample
    ) -> tuple[np.ndarray, str]:
        """Velocities (n,) of a controller that answers joints, within the limits."""
        answer = call_user_code(
            self.scheme.tick, t, dt, measured, limit=self.settings.scheme_timeout,
            scheme=self.name,
        )  # fmt: skip
        answer = checked_joints(self.name, answer, len(self.motion.names))
        if self.scheme.output == "position":
            velocities = np.zeros_like(answer)
            if dt > 0.0:
                velocities = (answer - self.motion.command) / dt
        elif self.scheme.output == "acceleration":
            velocities = self.motion.velocity + answer * dt
        else:
            velocities = answer
        return self.motion.limited(velocities, dt)
