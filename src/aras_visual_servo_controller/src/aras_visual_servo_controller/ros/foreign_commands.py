"""Detection of commands that other nodes publish to the joints of an arm."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from functools import partial

import rospy

from aras_visual_servo_ros.rospy_patches import send_to_others_only

from .command_publishers import CommandPublishers


class ForeignCommandListener:
    """Subscriber of the joints' command topics, which records commands of other nodes.

    The topics are subscribed at the first request, because most runs do not need them. They stay
    subscribed, because rospy leaks a file descriptor for every subscriber that is unregistered.
    """

    def __init__(self, commands: CommandPublishers) -> None:
        """Set the topics of this node's own commands."""
        self._commands, self._own_node = commands, rospy.get_name()
        self._is_active = self._is_subscribing = False
        self._subscribers: list[rospy.Subscriber] = []
        self._lock = threading.Lock()
        self._latest: dict[str, tuple[str, float]] = {}

    def listen(self, is_active: bool) -> None:
        """Start or stop reporting commands, without blocking."""
        self._is_active = is_active
        # Subscribing blocks while the ROS master is not reachable, so a thread subscribes.
        if is_active and not self._is_subscribing:
            self._is_subscribing = True
            threading.Thread(target=self._subscribe, name="foreign commands", daemon=True).start()

    def read_latest(self) -> Mapping[str, tuple[str, float]]:
        """Return the name of the node that last commanded each joint, and when, by joint name.

        The time is in s of monotonic wall time.
        """
        with self._lock:
            return dict(self._latest) if self._is_active else {}

    def _subscribe(self) -> None:
        self._commands.is_self_subscribed = True
        for topic, joints in self._commands.list_topics():
            send_to_others_only(topic)
            self._subscribers.append(rospy.Subscriber(
                topic, rospy.AnyMsg, partial(self._receive, joints), queue_size=1
            ))  # fmt: skip

    def close(self) -> None:
        """Unregister the subscribers."""
        for subscriber in self._subscribers:
            subscriber.unregister()

    def _receive(self, joints: Sequence[str], message: rospy.AnyMsg) -> None:
        node = message._connection_header.get("callerid", "an unnamed node")
        if node != self._own_node:
            with self._lock:
                self._latest.update(dict.fromkeys(joints, (node, time.monotonic())))
