"""Detection of other nodes that command the joints, or publish their states.

A node that commands the joints is detected by the motion of the joints and by its messages on the
command topics. A second publisher of joint states is detected by implausible joint states.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import numpy as np

from ..loop.command_integrator import JUMP
from ..loop.servo import Servo
from ..observation.joint_history import JointHistory
from ..records.outcomes import JOINTS_DO_NOT_FOLLOW, Outcome
from ..records.remedy import Remedy
from ..records.state import HOLDING, ImageSource, JointCommand
from ..settings import ControllerSettings

# The loop commands the joints again after this time, s, without a command of another node and
# without an unusable joint state.
QUIET_TIME = 1.0
# A stamp that differs from the clock by more than this, s, comes from another clock.
MAX_CLOCK_SKEW = 0.5
# Commands of other nodes are recorded for this wall time, s, after the last sign that another node
# commands the joints: a command of such a node, or a joint that does not follow.
LISTENING_TIME = 5.0


class ForeignCommandSource(Protocol):
    """Interface to the commands that other nodes send to the joints."""

    def listen(self, is_active: bool) -> None:
        """Start or stop receiving commands, without blocking."""

    def read_latest(self) -> Mapping[str, tuple[str, float]]:
        """Return the name of the node that last commanded each joint, and when, by joint name.

        The time is in s of monotonic wall time.
        """


class ForeignCommandWatch:
    """Detection of commands from other nodes to the joints of one loop.

    Attributes:
        can_name_nodes: whether the names of other nodes can be found, from the commands that they
            publish.
    """

    def __init__(
        self, servo: Servo, history: JointHistory, settings: ControllerSettings,
        commands: ForeignCommandSource | None,
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
        """Forget how far the joints have moved away from the command."""
        # Largest distance (n,) between joints and command since the command stopped changing, rad
        # or m.
        self._joint_errors: np.ndarray | None = None
        # Time of the last joint motion that another node may have commanded, s.
        self._acting_stamp: float | None = None

    def find_nodes(self, wall: float) -> None:
        """Report the other nodes that command joints at the wall time `wall` (s) to the loop.

        Commands of other nodes are recorded only while joints do not follow their commands, and for
        LISTENING_TIME afterwards.
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

    def can_resend(self, command: JointCommand) -> bool:
        """Return whether a position command that joints have not followed may be sent again.

        It may not if a joint moves away from its command, because then another node commands the
        joint. When the joint has been at rest for QUIET_TIME, the loop continues from the measured
        position.
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
            # The loop is holding because a joint is too far from its command; assume that another
            # node moves it.
            self._acting_stamp = command.stamp
        if self._acting_stamp is None:
            return True
        if command.stamp - self._acting_stamp >= QUIET_TIME:
            self.reset()
            self._servo.resume_own_commands()
        return False


class JointStateWatch:
    """Detection of joint states that cannot be used, such as those of a second publisher.

    While unusable joint states come between usable ones, it is unknown which of them are true.
    Therefore the arm is held until no unusable joint state has come for QUIET_TIME.
    """

    def __init__(
        self, source: ImageSource, names: Sequence[str], log: Callable[[str], None]
    ) -> None:
        """Create the detection.

        Args:
            source: source of the joint states, for messages.
            names: names of the n joints of the arm.
            log: function that logs one line.
        """
        self._source, self._names, self._log = source, frozenset(names), log
        self.clear()

    def clear(self) -> None:
        """Forget all joint states, because the clock was reset."""
        # Time of the latest unusable joint state, of the latest usable one, and of the latest with
        # a stamp of the loop's clock, s.
        self._fault_time = self._usable_time = self._punctual_time = -np.inf
        # Time (s) and fault of the first of the present unusable joint states. After a pause of
        # QUIET_TIME, a new series of them starts.
        self._since, self._fault = 0.0, ""
        self._is_mixed = False  # whether usable joint states come between unusable ones
        self._is_skew_logged = False

    def check_stamp(self, stamp: float, now: float) -> tuple[float, str]:
        """Return the time of a joint state, s, and why it cannot be used; '' if it can.

        If the stamp differs from the clock by more than MAX_CLOCK_SKEW, the robot has another
        clock, and the time of arrival is returned. If the stamp is ahead of the clock although
        other joint states have correct stamps, there is a second publisher, and the joint state
        cannot be used.

        Args:
            stamp: stamp of the joint state, s.
            now: present time, s.
        """
        ahead = stamp - now
        if abs(ahead) <= MAX_CLOCK_SKEW:
            self._punctual_time = now
            return stamp, ""
        if ahead > 0.0 and now - self._punctual_time < QUIET_TIME:
            return now, f"some are stamped {ahead:.2f} s ahead of the clock, others are not"
        if not self._is_skew_logged:
            self._is_skew_logged = True
            self._log(f"{self._source.describe_stamp_lead(ahead)}; used as of their arrival")
        return now, ""

    def is_of_other_joints(self, names: Sequence[str], now: float) -> bool:
        """Return whether a joint state has only joints of another part of the robot.

        Several nodes may publish the states of different joints on one topic. Return False if at
        the time `now` (s) no joint state of the arm has come for QUIET_TIME.
        """
        return now - self._usable_time < QUIET_TIME and self._names.isdisjoint(names)

    def add_usable(self, now: float) -> None:
        """Add a usable joint state that came at the time `now` (s)."""
        self._usable_time, self._is_mixed = now, True

    def add_unusable(self, now: float, fault: str) -> None:
        """Add a joint state that came at the time `now` (s) and cannot be used because of `fault`.
        """
        if self.find_outcome(now) is None:
            self._since, self._fault, self._is_mixed = now, fault, False
        self._fault_time = now

    def find_outcome(self, now: float) -> Outcome | None:
        """Return the outcome 'unusable_joint_states' if the arm has to be held; otherwise None.

        `now` is the present time, s.
        """
        if now - self._fault_time >= QUIET_TIME:
            return None
        topic, since = self._source.topic, f"since {self._since:.2f} s"
        advice = (
            f"check which node publishes them ('rostopic info {topic}'), and the limits in the "
            "robot description"
        )
        if self._is_mixed:
            since = f"{since}, between usable ones"
            advice = f"end the second publisher; 'rostopic info {topic}' lists the publishers"
        reason = f"unusable joint states on {topic} {since}: {self._fault}"
        return Outcome("unusable_joint_states", reason, Remedy(advice))
