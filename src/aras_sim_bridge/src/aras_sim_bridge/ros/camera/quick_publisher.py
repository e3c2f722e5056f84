"""A publisher that writes into its listeners' sockets itself.

rospy gives every connection a thread, wakes it for every message and copies the message four
times on the way: at 250 Hz of /clock and a few listeners that is the largest part of what an idle
simulator uses, and for images it is milliseconds. Here the caller writes, without ever waiting.
"""

from __future__ import annotations

import struct
import threading
from collections.abc import Callable
from io import BytesIO
from typing import Any

import rospy

from aras_sim_bridge.ros.control.lane import Lane, Parts

_LENGTH = struct.Struct("<I")


def listeners(publisher: rospy.Publisher) -> int:
    """Number of listeners, without the topic's lock.

    rospy holds that lock while it tells a SubscribeListener: two topics that lose a listener at
    once, and whose SubscribeListeners ask for each other's number, would wait for each other.
    """
    implementation = publisher.impl
    return 0 if implementation is None else len(implementation.connections)


class QuickPublisher:
    """Publishes from one thread; listeners connect and go as with any rospy.Publisher."""

    def __init__(
        self, topic: str, message: type, queue_size: int, latch: bool = False, **options: Any
    ) -> None:
        """Advertise; `latch`: who comes later gets the last message; `options`: rospy's."""
        self._queue_size = queue_size
        self._lock = threading.Lock()
        self._lanes: dict[Any, Lane] = {}
        self._latched: Parts | None = None
        self._sequence = 0
        # rospy tells listeners of the latch, but never has a message to latch: see _welcome.
        self._latch = latch
        self._publisher = rospy.Publisher(
            topic, message, queue_size=queue_size, latch=latch, tcp_nodelay=True, **options
        )
        if latch:
            self._publisher.impl.add_subscriber_listener(_Welcome(self._welcome))

    def publish(self, message: Any) -> None:
        """Send a message to those who listen; its header gets the next sequence number."""
        if not self._wanted():
            return
        if message._has_header:
            message.header.seq = self.next_sequence()
        buffer = BytesIO()
        message.serialize(buffer)
        self.publish_bytes(buffer.getvalue())

    def next_sequence(self) -> int:
        """Number for the header of the next message."""
        self._sequence += 1
        return self._sequence

    def publish_bytes(self, *body: bytes | memoryview) -> None:
        """Send a message that is serialised already, in parts that must not change any more."""
        if not self._wanted():
            return
        parts = (_LENGTH.pack(sum(map(len, body))), *body)
        with self._lock:
            if self._latch:
                self._latched = parts
            implementation = self._publisher.impl
            if implementation is None:  # unregistered meanwhile
                return
            connections = implementation.connections
            if len(self._lanes) > len(connections):
                self._lanes = {c: lane for c, lane in self._lanes.items() if c in connections}
            for connection in connections:
                lane = self._lanes.get(connection) or self._open(connection)
                if lane is not None:
                    lane.send(parts)

    def get_num_connections(self) -> int:
        """Number of listeners."""
        return listeners(self._publisher)

    def unregister(self) -> None:
        """Take the topic off the graph."""
        self._publisher.unregister()

    def _wanted(self) -> bool:
        return self._latch or listeners(self._publisher) > 0

    def _open(self, connection: Any) -> Lane | None:
        """Return the lane of a new connection; None while it is not up."""
        if connection.socket is None:
            return None
        lane = self._lanes[connection] = Lane(connection, self._queue_size, self._close)
        return lane

    def _welcome(self) -> None:
        """Send the latched message to whoever has just come."""
        with self._lock:
            implementation = self._publisher.impl
            if self._latched is None or implementation is None:
                return
            for connection in implementation.connections:
                if connection not in self._lanes and (lane := self._open(connection)) is not None:
                    lane.send(self._latched)

    def _close(self, connection: Any) -> None:
        """Forget a connection that broke; not from here, where its lane is at work."""
        threading.Thread(target=self._drop, args=(connection,), daemon=True).start()

    def _drop(self, connection: Any) -> None:
        with self._lock:
            self._lanes.pop(connection, None)
        implementation = self._publisher.impl
        if implementation is not None:
            implementation.remove_connection(connection)
        connection.close()


class _Welcome(rospy.SubscribeListener):
    def __init__(self, on_new: Callable[[], None]) -> None:
        super().__init__()
        self._on_new = on_new

    def peer_subscribe(self, *_args: object) -> None:
        self._on_new()
