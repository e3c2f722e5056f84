"""Detection of other nodes that command the joints.

Such nodes are detected by the motion of the joints, and by messages on the command topics.
"""

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

QUIET_TIME = 1.0  # time without a foreign command after which the loop commands the joints again, s
# Commands of other nodes are received for this wall time, s, after the last sign of such a node.
LISTENING_TIME = 5.0


class ForeignCommands(Protocol):
    """Interface to the commands that other nodes send to the joints."""

    def listen(self, is_active: bool) -> None:
        """Start or stop receiving commands, without blocking."""

    def read_latest(self) -> Mapping[str, tuple[str, float]]:
        """Return the node that last commanded each joint, by joint name.

        The second value is the time of that command, s of monotonic wall time.
        """


class ForeignWatch:
    """Detection of commands from other nodes to the joints of one loop.

    Attributes:
        can_name_nodes: whether other nodes can be named, because their commands can be received.
    """

    def __init__(
        self, servo: Servo, history: JointHistory, settings: Settings,
        commands: ForeignCommands | None,
    ) -> None:
        """Create the detection.

        Args:
            servo: the loop.
            history: history of its joint states.
            settings: settings of the loop.
            commands: source of other nodes' commands; None if they cannot be received.
        """
        self._servo, self._history, self._settings = servo, history, settings
        self._commands, self._suspicion_time = commands, -np.inf
        self._lead = np.atleast_1d(np.asarray(servo.settings.lead, float))
        self.can_name_nodes = commands is not None and not settings.lockstep
        self.reset()

    def reset(self) -> None:
        """Forget the past motion of the joints, because they get a new command."""
        # Distance (n,) of the joints from the command at the time when the command stopped
        # changing, rad or m.
        self._joint_errors: np.ndarray | None = None
        # Time of the last motion that a foreign command may have caused, s.
        self._acting_stamp: float | None = None

    def find_nodes(self, wall: float) -> None:
        """Report to the loop which nodes command the joints at the wall time `wall`, s.

        Commands are received only while joints do not follow, and for LISTENING_TIME afterwards.
        """
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
        """Return whether a position command that joints have not followed may be sent again.

        A joint that moves away from its command follows foreign commands, even if these cannot be
        received. In this case nothing is sent until the joint has been at rest for QUIET_TIME. Then
        the loop continues from the measured position.
        """
        if not self._servo.is_waiting_for_joints or (newest := self._history.newest) is None:
            return False
        if command.stamp - newest.stamp > self._settings.watchdog:
            return False  # the present joint positions are unknown
        behind = np.abs(command.values - newest.positions)
        if self._joint_errors is None:
            self._joint_errors = behind
        if (behind > self._joint_errors + JUMP * self._lead).any():
            self._joint_errors, self._acting_stamp = (
                np.maximum(self._joint_errors, behind),
                command.stamp,
            )
        elif self._acting_stamp is None and self._servo.phase == HOLDING:
            # The joint is farther from the command than the loop allows, so a foreign command may
            # move it.
            self._acting_stamp = command.stamp
        if self._acting_stamp is None:
            return True
        if command.stamp - self._acting_stamp >= QUIET_TIME:
            self.reset()
            self._servo.resume_own_commands()
        return False
