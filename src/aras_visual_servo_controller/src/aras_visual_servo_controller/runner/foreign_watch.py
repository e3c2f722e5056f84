"""Other nodes that command the joints: seen by how the joints move, and named where they can be."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from ..loop.command_integrator import JUMP
from ..loop.servo import Servo
from ..observation.joint_history import JointHistory
from ..records.outcomes import JOINTS_DO_NOT_FOLLOW
from ..records.state import HOLDING, Command
from ..settings import Settings

QUIET_TIME = 1.0  # s without a foreign command after which the loop commands the joints again
# s of wall time for which foreign commands are listened for after the last sign
LISTENING_TIME = 5.0


class ForeignCommands(Protocol):
    """Receives the commands that other nodes send to the joints."""

    def listen(self, is_active: bool) -> None:
        """Start or stop to receive them; returns at once."""

    def read_latest(self) -> Mapping[str, tuple[str, float]]:
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
        self._commands, self._suspicion_time = commands, -np.inf
        self._lead = np.atleast_1d(np.asarray(servo.settings.lead, float))
        self.can_name_nodes = commands is not None and not settings.lockstep
        self.reset()

    def reset(self) -> None:
        """The joints are commanded anew: what they did before counts no more."""
        # (n,) that the joints lacked when it came to rest
        self._joint_errors: np.ndarray | None = None
        self._acting_stamp: float | None = None  # when a foreign command seemed to act last, s

    def find_nodes(self, wall: float) -> None:
        """Name the nodes that command the joints at `wall`, s of wall time; listen for them while
        joints do not follow."""
        active = {
            joint: node for joint, (node, at) in self._commands.read_latest().items()
            if wall - at < QUIET_TIME
        }  # fmt: skip
        servo = self._servo
        servo.set_foreign_nodes(active)
        if active or servo.is_waiting_for_joints or servo.outcome.kind == JOINTS_DO_NOT_FOLLOW:
            self._suspicion_time = wall
        self._commands.listen(wall - self._suspicion_time < LISTENING_TIME)

    def can_resend(self, command: Command) -> bool:
        """Whether a position command that joints have not followed may be sent again.

        A joint that moves away from its command follows foreign commands that cannot be received.
        Until it has rested for QUIET nothing is sent; then the loop continues from where it is.
        """
        newest = self._history.newest
        if newest is None or not self._servo.is_waiting_for_joints:
            return False
        if command.stamp - newest.stamp > self._settings.watchdog:
            return False  # nobody knows where they are
        behind = np.abs(command.values - newest.positions)
        if self._joint_errors is None:
            self._joint_errors = behind
        if (behind > self._joint_errors + JUMP * self._lead).any():
            self._joint_errors, self._acting_stamp = (
                np.maximum(self._joint_errors, behind),
                command.stamp,
            )
        elif self._acting_stamp is None and self._servo.phase == HOLDING:
            self._acting_stamp = command.stamp  # farther away than the loop itself lets them be
        if self._acting_stamp is None:
            return True
        if command.stamp - self._acting_stamp >= QUIET_TIME:
            self.reset()
            self._servo.resume_own_commands()
        return False
