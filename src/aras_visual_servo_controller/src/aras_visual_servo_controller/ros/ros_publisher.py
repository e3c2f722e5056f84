"""Publication of the loop's commands, states and log messages."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

import rospy
from geometry_msgs.msg import TwistStamped

from ..msg import ServoReport, ServoState
from ..records.state import APPROACHING, SERVOING, JointCommand
from ..records.state import ServoState as State
from ..settings import ControllerSettings
from .command_publishers import CommandPublishers, publish
from .foreign_commands import ForeignCommandListener
from .messages import make_report_message, make_state_message

LISTENERS_TIMEOUT = 5.0  # wall time for which the node waits for a recorder's subscription, s
REPEAT_WARNING = 5.0  # wall time between two warnings of topics without subscribers, s


class RosPublisher:
    """LoopListener that publishes the output of the loop to ROS.

    Attributes:
        names: names of the joints.
        command_publishers: publishers of the joint commands.
        foreign_commands: listener for commands of other nodes on these topics.
        state_publisher: publisher of controller/state.
        latest_state: state that was reported last.
    """

    def __init__(self, settings: ControllerSettings, names: Sequence[str], frame: str) -> None:
        """Advertise the topics.

        Args:
            settings: settings with the names of the topics.
            names: names of the joints.
            frame: optical frame of the control camera.
        """
        self._settings, self.names, self._frame = settings, tuple(names), frame
        namespace = settings.namespace.rstrip("/")
        self.command_publishers = CommandPublishers(settings, self.names, settings.output)
        self.foreign_commands = ForeignCommandListener(self.command_publishers)
        self.state_publisher, self._report_publisher, self._twist_publisher = (
            rospy.Publisher(f"{namespace}/controller/{name}", kind, queue_size=5)
            for name, kind in (("state", ServoState), ("diagnosis", ServoReport),
                               ("camera_twist", TwistStamped))
        )  # fmt: skip
        self.latest_state: State | None = None
        self._logged, self._log_time = ("", ""), -math.inf
        # Time (s) of the last check whether the command topics have subscribers.
        self._check_time: float | None = None

    def wait_for_listeners(self) -> None:
        """Wait for a recorder to connect, before the node sends or receives anything."""
        deadline, needed = time.monotonic() + LISTENERS_TIMEOUT, self._settings.listeners
        while self.state_publisher.get_num_connections() < needed and not rospy.is_shutdown():
            if time.monotonic() > deadline:
                rospy.logwarn(
                    "controller/state has %d of %g subscribers after %g s: starting without them",
                    self.state_publisher.get_num_connections(), needed, LISTENERS_TIMEOUT,
                )  # fmt: skip
                return
            time.sleep(0.02)

    def close(self) -> None:
        """Unregister all publishers and subscribers."""
        self.foreign_commands.close()
        self.command_publishers.close()
        for publisher in (self.state_publisher, self._report_publisher, self._twist_publisher):
            publisher.unregister()

    def send(self, command: JointCommand) -> None:
        """Publish a command to the joints."""
        if command.values is not None:
            self.command_publishers.send(command.values)
            self._check_listeners()

    def report(self, state: State) -> None:
        """Publish the state for one image, and log a change of the phase or the reason."""
        self.latest_state = state
        frame = self._frame
        # Time.from_sec truncates, so its stamp could be 1 ns before that of the image.
        stamp = rospy.Time(0, round(1e9 * max(state.stamp, 0.0)))
        message = make_state_message(state, self._settings.scheme, frame, self.names)
        message.header.stamp = stamp
        publish(self.state_publisher, message)
        if self._report_publisher.get_num_connections():
            report = make_report_message(state, frame, self.names)
            report.header.stamp = stamp
            publish(self._report_publisher, report)
        publish(
            self._twist_publisher, TwistStamped(header=message.header, twist=message.camera_twist)
        )
        self._log_state(state.phase, state.reason)

    def _check_listeners(self) -> None:
        """Warn periodically if command topics have no subscribers, because the arm cannot move."""
        now = time.monotonic()
        if self._check_time is None:
            self._check_time = now
        elif now - self._check_time > REPEAT_WARNING:
            self._check_time = now
            if topics := self.command_publishers.list_unsubscribed():
                rospy.logwarn(
                    "no controller subscribes to %s: start that controller (rosrun "
                    "controller_manager controller_manager list), or name another one in "
                    "~controllers", ", ".join(topics),
                )  # fmt: skip

    def log(self, text: str) -> None:
        """Log a line, or the traceback of an error in a scheme."""
        (rospy.logerr if "\n" in text else rospy.loginfo)("%s", text)

    def _log_state(self, phase: str, reason: str) -> None:
        """Log a new phase once, and a reason when the phase changes or every few seconds."""
        now, new = time.monotonic(), phase != self._logged[0]
        if not new and (not reason or now - self._log_time < REPEAT_WARNING):
            return
        fine = phase in (SERVOING, APPROACHING) or not reason
        (rospy.loginfo if fine else rospy.logwarn)("%s%s", phase, f": {reason}" if reason else "")
        self._logged, self._log_time = (phase, reason), now
