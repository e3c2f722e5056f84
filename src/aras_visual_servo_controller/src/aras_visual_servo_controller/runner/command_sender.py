"""Sending of the loop's commands to the joints."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ..kinematics.algebra import is_finite
from ..loop.servo import Servo
from ..records.state import STOPPED, JointCommand, ServoState
from ..settings import ControllerSettings
from .foreign_command_watch import ForeignCommandWatch

REPEAT_PERIOD = 0.1  # period at which a command that a joint does not follow is sent again, s


class LoopListener(Protocol):
    """Receiver of the loop's output."""

    def send(self, command: JointCommand) -> None:
        """Send a command to the joints."""

    def report(self, state: ServoState) -> None:
        """Report the state of the loop, for an image or without one."""

    def log(self, text: str) -> None:
        """Log one line."""


class CommandSender:
    """Sends commands to the joints: an unchanged position only if a joint does not follow it.

    Attributes:
        values: (n,) values that were sent last; None if no command is in effect.
        is_e_stopped: whether the emergency stop has been pressed since the last start.
    """

    def __init__(
        self,
        servo: Servo,
        settings: ControllerSettings,
        foreign_watch: ForeignCommandWatch,
        listener: LoopListener,
    ) -> None:
        """Create the sender of commands to a listener."""
        self._servo, self._settings = servo, settings
        self._foreign_watch, self._listener = foreign_watch, listener
        self.is_e_stopped = self._is_ended = False
        self.clear()

    def clear(self) -> None:
        """Forget the commands that were sent."""
        self.values: np.ndarray | None = None
        self._stamp = 0.0
        self._foreign_watch.reset()

    def send(self, command: JointCommand, repeat: bool = False) -> None:
        """Send a command; with `repeat`, send equal positions again if a joint does not follow."""
        values = command.values
        if self._is_ended or values is None or not is_finite(values):
            return
        if self.values is None and self._servo.phase == STOPPED:
            # The loop has not been started, and another node may command the joints: send nothing.
            return
        is_position = command.kind == "position"
        if is_position and self._servo.is_yielding:
            # The last command is no longer in effect, because another node commands the joints.
            self.values = None
            return
        if self.values is None or values.tolist() != self.values.tolist():
            self._foreign_watch.reset()
        elif is_position and not repeat:
            # A position is sent again if the controller may not have received it, for example
            # because the controller was loaded later.
            allowed = not self.is_e_stopped and self._foreign_watch.can_resend(command)
            if not allowed or command.stamp - self._stamp < REPEAT_PERIOD - 1e-9:
                return
        self.values, self._stamp = values, command.stamp
        if not self._settings.dry:
            self._listener.send(command)

    def note_sent(self, values: np.ndarray, stamp: float) -> None:
        """Note the values (n,) of the latest command of compiled updates, sent at `stamp` (s)."""
        if stamp > self._stamp:
            self.values, self._stamp = values, stamp
            self._foreign_watch.reset()

    def end(self, t: float) -> None:
        """Send no more commands; if the output is velocity or effort, first send zeros.

        `t` is the stamp of this last command, s.
        """
        self._is_ended = True
        kind, names = self._settings.output, self._servo.arm.names
        if kind != "position" and not self._settings.dry:
            zeros = np.zeros(len(names))
            self._listener.send(JointCommand(t, names, zeros, kind, phase=STOPPED))
