"""Goals of the controllers' actions, and the base class of controllers with an action."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from aras_sim_bridge.control.controllers.base import Controller

ACTIVE = "active"
REJECTED = "rejected"
SUCCEEDED = "succeeded"
ABORTED = "aborted"
PREEMPTED = "preempted"


@dataclass(slots=True, eq=False)
class GoalHandle:
    """An action goal, its status and its result; used only in the simulation thread.

    Attributes:
        goal: goal, in the type of the controller.
        status: 'active', 'rejected', 'succeeded', 'aborted' or 'preempted'.
        result: result of the goal; None while the goal is active.
        on_feedback: function that is called with the states of a trajectory controller while it
            follows the goal.
        on_done: function that is called with this handle when an active goal ends.
    """

    goal: object
    status: str = ACTIVE
    result: object | None = None
    on_feedback: Callable[[object], None] | None = None
    on_done: Callable[[GoalHandle], None] | None = None

    @property
    def is_done(self) -> bool:
        """Whether the goal has ended."""
        return self.status != ACTIVE

    def finish(self, status: str, result: object) -> None:
        """End the goal and call `on_done`."""
        self.status, self.result = status, result
        if self.on_done is not None:
            self.on_done(self)


class ActionController(Controller):
    """Base class of controllers with an action, of which at most one goal is active.

    All methods must be called in the simulation thread. The functions `on_done`, `on_feedback` and
    `on_state` may call the controller, because a method calls them only when the controller is
    ready for the next command.
    """

    _goal: GoalHandle | None = None
    _running = False

    def _init_output(self, parameters: Mapping) -> None:
        """Read the parameters that `_command` needs."""

    def _start_output(self) -> None:
        """Write commands that hold the joints."""

    def _command(self, period: float) -> float | None:
        """Write the commands of one control cycle; a gripper returns its effort."""
        raise NotImplementedError

    def _hold_position(self) -> None:
        """Choose the measured positions as desired positions."""
        raise NotImplementedError

    def _preempt_goal(self, reason: str, next_goal: GoalHandle | None = None) -> None:
        """End the active goal, if there is one, as preempted; `next_goal` replaces it."""
        raise NotImplementedError

    def stopping(self, time_ns: int) -> None:
        """Cancel the active goal."""
        self._running = False
        self._preempt_goal("controller stopped")

    def cancel_goal(self, handle: GoalHandle) -> bool:
        """Stop the joints if `handle` is the active goal; return whether it was active."""
        if self._goal is not handle:
            return False
        self._hold_position()
        self._preempt_goal("cancelled")
        return True

    def _end_goal(self, status: str, result: object, next_goal: GoalHandle | None = None) -> None:
        """End the active goal, if there is one; `next_goal` replaces it."""
        goal, self._goal = self._goal, next_goal
        if goal is not None:
            goal.finish(status, result)
