"""Commands that other nodes publish to the joints of one arm."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from functools import partial

import genpy
import rospy

from .commands import CommandTopics


class ForeignCommandListener:
    """The ForeignCommands of a Driver: subscribes to the joints' command topics on demand.

    The loop's own commands come back on these topics too, so it only subscribes while it is told
    to listen.
    """

    def __init__(self, commands: CommandTopics) -> None:
        """`commands`: the topics of the loop's own commands."""
        self._commands, self._own = commands, rospy.get_name()
        self._active = False
        self._subscribers: list[rospy.Subscriber] = []
        self._lock = threading.Lock()
        self._latest: dict[str, tuple[str, float]] = {}

    def listen(self, active: bool) -> None:
        """Start or stop to receive commands, at the next `update`."""
        self._active = active

    def latest(self) -> Mapping[str, tuple[str, float]]:
        """By joint: the node that commanded it last, and when, s of wall time (monotonic)."""
        with self._lock:
            return dict(self._latest)

    def update(self) -> None:
        """Subscribe or unsubscribe as told. It asks the master, which can take time: call it
        outside the loop's thread."""
        if self._active and not self._subscribers:
            self._subscribers = [
                rospy.Subscriber(topic, kind, partial(self._receive, joints), queue_size=1)
                for topic, kind, joints in self._commands.listed()
            ]
            self._commands.echoed = True
        elif not self._active and self._subscribers:
            self.close()

    def close(self) -> None:
        """Unsubscribe."""
        for subscriber in self._subscribers:
            subscriber.unregister()
        self._subscribers, self._commands.echoed = [], False
        with self._lock:
            self._latest.clear()

    def _receive(self, joints: Sequence[str], message: genpy.Message) -> None:
        node = message._connection_header.get("callerid", "an unnamed node")
        if node != self._own:
            with self._lock:
                self._latest.update(dict.fromkeys(joints, (node, time.monotonic())))
