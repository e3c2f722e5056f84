"""Goal handles of the controllers' actions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

ACTIVE = "active"
REJECTED = "rejected"
SUCCEEDED = "succeeded"
ABORTED = "aborted"
PREEMPTED = "preempted"

Goal = TypeVar("Goal")
Result = TypeVar("Result")


class GoalHandle(Generic[Goal, Result]):
    """An action goal, its status and its result; used only in the simulation thread.

    `status` is 'active', 'rejected', 'succeeded', 'aborted' or 'preempted'; `result` is set unless
    the goal is active. `on_feedback` is called with the states of a trajectory controller while it
    follows the goal. `on_done(GoalHandle)` is called once, when the goal ends, or immediately if it
    is set after the end.
    """

    def __init__(self, goal: Goal) -> None:
        self.goal = goal
        self.status = ACTIVE
        self.result: Result | None = None
        self.on_feedback: Callable[[object], None] | None = None
        self._on_done: Callable[[GoalHandle], None] | None = None
        self._is_announced = False

    @property
    def is_done(self) -> bool:
        """Whether the goal has ended."""
        return self.status != ACTIVE

    @property
    def on_done(self) -> Callable[[GoalHandle], None] | None:
        """Function that is called with this handle when the goal has ended."""
        return self._on_done

    @on_done.setter
    def on_done(self, callback: Callable[[GoalHandle], None] | None) -> None:
        self._on_done = callback
        self.announce()

    def finish(self, status: str, result: Result) -> None:
        """Call on_done if the goal has ended, unless on_done has already been called."""
        if not self.is_done:
            self.result = result
            self.status = status

    def announce(self) -> None:
        """Call on_done if the goal has ended and on_done has not been called yet."""
        callback = self._on_done
        if callback is not None and self.is_done and not self._is_announced:
            self._is_announced = True
            callback(self)
