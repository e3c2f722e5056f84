"""What the loop tells the world: commands, states, words."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
import rospy
from geometry_msgs.msg import TwistStamped
from std_msgs.msg import Float64, Float64MultiArray

from ..msg import ServoReport, ServoState
from ..settings import Settings
from ..state import APPROACHING, SERVOING, Command
from ..state import ServoState as State
from .messages import report_message, state_message

LISTENERS_TIMEOUT = 5.0  # s of wall time
REPEAT_WARNING = 5.0  # s of wall time


class RosFace:
    """Publishers of one controller; a Face of the Driver."""

    def __init__(self, settings: Settings, names: Sequence[str]) -> None:
        self._settings, self.names = settings, tuple(names)
        space = settings.namespace.rstrip("/")
        self._group = None
        self._each: list[rospy.Publisher] = []
        if settings.command_topic:
            topic = settings.command_topic
            topic = topic if topic.startswith("/") else f"{space}/{topic}"
            self._group = rospy.Publisher(topic, Float64MultiArray, queue_size=1)
        else:
            for name in self.names:
                controller = settings.controllers.get(name, f"{name}_{settings.output}_controller")
                topic = f"{space}/{controller}/command"
                self._each.append(rospy.Publisher(topic, Float64, queue_size=1))
        self.state = rospy.Publisher(f"{space}/controller/state", ServoState, queue_size=5)
        self._reports = rospy.Publisher(f"{space}/controller/diagnosis", ServoReport, queue_size=5)
        self._twists = rospy.Publisher(
            f"{space}/controller/camera_twist", TwistStamped, queue_size=5
        )
        self.latest: State | None = None
        self._said, self._said_at = ("", ""), -1e9

    def await_listeners(self) -> None:
        """Give a recorder the time to connect; nothing has been subscribed to or sent yet."""
        deadline, wanted = time.monotonic() + LISTENERS_TIMEOUT, self._settings.listeners
        while self.state.get_num_connections() < wanted and not rospy.is_shutdown():
            if time.monotonic() > deadline:
                rospy.logwarn(
                    "controller/state has %d of %g listeners after %g s: beginning without them",
                    self.state.get_num_connections(), wanted, LISTENERS_TIMEOUT,
                )  # fmt: skip
                return
            time.sleep(0.02)

    def close(self) -> None:
        """Publish no more."""
        for publisher in (*self._each, self._group, self.state, self._reports, self._twists):
            if publisher is not None:
                publisher.unregister()

    def send(self, command: Command) -> None:
        """To the joints, whichever of the three it is."""
        for values in (command.positions, command.velocities, command.efforts):
            if values is not None:
                self.put(values)

    def put(self, values: np.ndarray) -> None:
        """Numbers (n,) to the joints' controllers."""
        if self._group is not None:
            _publish(self._group, Float64MultiArray(data=values.tolist()))
        for publisher, value in zip(self._each, values.tolist(), strict=False):
            _publish(publisher, Float64(value))

    def report(self, state: State) -> None:
        """Publish the state of one image, and log what is new about it."""
        self.latest = state
        frame, stamp = self._settings.camera_frame, rospy.Time.from_sec(max(state.stamp, 0.0))
        message = state_message(state, self._settings.scheme, frame, self.names)
        message.header.stamp = stamp
        _publish(self.state, message)
        if self._reports.get_num_connections():
            report = report_message(state, frame, self.names)
            report.header.stamp = stamp
            _publish(self._reports, report)
        _publish(self._twists, TwistStamped(header=message.header, twist=message.camera_twist))
        self._log(state.phase, state.reason)

    def say(self, text: str) -> None:
        """One line, or the traceback of a scheme's fault."""
        (rospy.logerr if "\n" in text else rospy.loginfo)("%s", text)

    def _log(self, phase: str, reason: str) -> None:
        """A new phase once; what is wrong when it changes kind, or every few seconds."""
        now, new = time.monotonic(), phase != self._said[0]
        if not new and (not reason or now - self._said_at < REPEAT_WARNING):
            return
        fine = phase in (SERVOING, APPROACHING) or not reason
        (rospy.loginfo if fine else rospy.logwarn)("%s%s", phase, f": {reason}" if reason else "")
        self._said, self._said_at = (phase, reason), now


def _publish(publisher: rospy.Publisher, message: object) -> None:
    """Publish, but not into topics that the shutdown has closed while we were computing."""
    try:
        publisher.publish(message)
    except rospy.ROSException:
        if not rospy.core.is_shutdown_requested():
            raise
