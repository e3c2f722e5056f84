"""Other nodes that command the joints: seen by how the joints move, and named where they can be."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from ..loop.motion import JUMP
from ..loop.servo import Servo
from ..records.outcomes import DO_NOT_FOLLOW
from ..records.state import HOLDING, Command
from ..seeing.joint_history import JointHistory
from ..settings import Settings

QUIET = 1.0  # s without a foreign command after which the loop commands the joints again
LISTENING = 5.0  # s of wall time for which foreign commands are listened for after the last sign


class ForeignCommands(Protocol):
    """Receives the commands that other nodes send to the joints."""

    def listen(self, active: bool) -> None:
        """Start or stop to receive them; returns at once."""

    def latest(self) -> Mapping[str, tuple[str, float]]:
        """By joint: the node that commanded it last, and when, s of wall time (monotonic)."""


class ForeignWatch:
    """Finds foreign commands to the joints of one loop.

    Attributes:
        is_able: whether the nodes can be named: their commands can be received.
    """

    def __init__(
        self, servo: Servo, history: JointHistory, settings: Settings,
        commands: ForeignCommands | None,
    ) -> None:
        """`commands`: of other nodes; None where they cannot be received."""
        self._servo, self._history, self._settings = servo, history, settings
        self._commands, self._suspected = commands, -np.inf
        self._lead = np.atleast_1d(np.asarray(servo.settings.lead, float))
        self.is_able = commands is not None and not settings.lockstep
        self.forget()

    def forget(self) -> None:
        """The joints are commanded anew: what they did before counts no more."""
        self._behind: np.ndarray | None = None  # (n,) that the joints lacked when it came to rest
        self._acted: float | None = None  # when a foreign command seemed to act last, s

    def find(self, wall: float) -> None:
        """Name the nodes that command the joints at `wall`, s of wall time; listen for them while
        joints do not follow."""
        active = {
            joint: node for joint, (node, at) in self._commands.latest().items()
            if wall - at < QUIET
        }  # fmt: skip
        servo = self._servo
        servo.set_foreign(active)
        if active or servo.waits_for_joints or servo.outcome.kind == DO_NOT_FOLLOW:
            self._suspected = wall
        self._commands.listen(wall - self._suspected < LISTENING)

    def allows(self, command: Command) -> bool:
        """Whether a position command that joints have not followed may be sent again.

        A joint that moves away from its command follows foreign commands that cannot be received.
        Until it has rested for QUIET nothing is sent; then the loop continues from where it is.
        """
        newest = self._history.newest
        if newest is None or not self._servo.waits_for_joints:
            return False
        if command.stamp - newest.stamp > self._settings.watchdog:
            return False  # nobody knows where they are
        behind = np.abs(command.values - newest.positions)
        if self._behind is None:
            self._behind = behind
        if (behind > self._behind + JUMP * self._lead).any():
            self._behind, self._acted = np.maximum(self._behind, behind), command.stamp
        elif self._acted is None and self._servo.phase == HOLDING:
            self._acted = command.stamp  # farther away than the loop itself lets them be
        if self._acted is None:
            return True
        if command.stamp - self._acted >= QUIET:
            self.forget()
            self._servo.foreign_commands_ended()
        return False
