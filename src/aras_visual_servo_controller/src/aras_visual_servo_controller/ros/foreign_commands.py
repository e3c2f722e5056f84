"""Commands that other nodes publish to the joints of one arm."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from functools import partial

import rospy

from .commands import CommandTopics


class ForeignCommandListener:
    """The ForeignCommands of a Driver: subscribes to the joints' command topics when first needed.

    The loop's own commands come back on these topics too, so most runs do without. It stays
    subscribed then: rospy keeps a descriptor of every subscriber that was given up.
    """

    def __init__(self, commands: CommandTopics) -> None:
        """`commands`: the topics of the loop's own commands."""
        self._commands, self._own_node = commands, rospy.get_name()
        self._is_active = self._is_subscribing = False
        self._subscribers: list[rospy.Subscriber] = []
        self._lock = threading.Lock()
        self._latest: dict[str, tuple[str, float]] = {}

    def listen(self, is_active: bool) -> None:
        """Start or stop to report commands; returns at once."""
        self._is_active = is_active
        # rospy asks the master, for as long as that is away
        if is_active and not self._is_subscribing:
            self._is_subscribing = True
            threading.Thread(target=self._subscribe, name="foreign commands", daemon=True).start()

    def read_latest(self) -> Mapping[str, tuple[str, float]]:
        """By joint: the node that commanded it last, and when, s of wall time (monotonic)."""
        with self._lock:
            return dict(self._latest) if self._is_active else {}

    def _subscribe(self) -> None:
        self._commands.is_self_subscribed = True
        for topic, joints in self._commands.list_topics():
            self._subscribers.append(rospy.Subscriber(
                topic, rospy.AnyMsg, partial(self._receive, joints), queue_size=1
            ))  # fmt: skip

    def close(self) -> None:
        """Unsubscribe."""
        for subscriber in self._subscribers:
            subscriber.unregister()

    def _receive(self, joints: Sequence[str], message: rospy.AnyMsg) -> None:
        node = message._connection_header.get("callerid", "an unnamed node")
        if node != self._own_node:
            with self._lock:
                self._latest.update(dict.fromkeys(joints, (node, time.monotonic())))
