"""A publisher for small messages that go out hundreds of times a second.

rospy gives every connection a thread and wakes it for every message: at 250 Hz of /clock and a few
listeners that is the largest part of what an idle simulator uses. Here the caller writes into the
socket itself, without ever waiting: what does not fit stays behind, and of a listener that does
not read for long the oldest messages are dropped, as from rospy's queue.
"""

from __future__ import annotations

import collections
import socket
import struct
from io import BytesIO
from typing import Any

import rospy

_LENGTH = struct.Struct("<I")


class _Lane:
    """What has not been taken by one connection's socket yet."""

    __slots__ = ("_socket", "_waiting", "_begun")

    def __init__(self, connection: Any, queue_size: int) -> None:
        self._socket = connection.socket
        self._begun = b""  # the rest of a message whose beginning was sent
        self._waiting: collections.deque[bytes] = collections.deque(maxlen=queue_size)

    def send(self, data: bytes) -> None:
        """Write what the socket takes now; raises OSError when the connection is lost."""
        if self._begun or self._waiting:
            self._waiting.append(data)
            self._flush()
            return
        sent = self._write(data)
        if sent == 0:
            self._waiting.append(data)
        elif sent < len(data):
            self._begun = data[sent:]

    def _flush(self) -> None:
        while True:
            if self._begun:
                self._begun = self._begun[self._write(self._begun) :]
                if self._begun:
                    return
            if not self._waiting:
                return
            self._begun = self._waiting.popleft()

    def _write(self, data: bytes) -> int:
        try:
            return self._socket.send(data, socket.MSG_DONTWAIT)
        except (BlockingIOError, InterruptedError):
            return 0


class QuickPublisher:
    """Publishes from one thread; listeners connect and go as with any rospy.Publisher."""

    def __init__(self, topic: str, message: type, queue_size: int, **options: Any) -> None:
        """Advertise; `options` are rospy.Publisher's (no latch)."""
        self._queue_size = queue_size
        self._publisher = rospy.Publisher(
            topic, message, queue_size=queue_size, tcp_nodelay=True, **options
        )
        self._lanes: dict[Any, _Lane] = {}
        self._sequence = 0

    def publish(self, message: Any) -> None:
        """Send a message to those who listen; its header gets the next sequence number."""
        if not self._listened_to():
            return
        if message._has_header:
            self._sequence += 1
            message.header.seq = self._sequence
        buffer = BytesIO()
        message.serialize(buffer)
        self.publish_bytes(buffer.getvalue())

    def publish_bytes(self, body: bytes) -> None:
        """Send a message that is serialised already."""
        if not self._listened_to():
            return
        data = _LENGTH.pack(len(body)) + body
        implementation = self._publisher.impl
        connections = implementation.connections
        if len(self._lanes) > len(connections):
            self._lanes = {c: lane for c, lane in self._lanes.items() if c in connections}
        for connection in connections:
            lane = self._lanes.get(connection)
            if lane is None:
                if connection.socket is None:
                    continue
                lane = self._lanes[connection] = _Lane(connection, self._queue_size)
            try:
                lane.send(data)
            except OSError:  # the listener is gone
                del self._lanes[connection]
                implementation.remove_connection(connection)
                connection.close()

    def _listened_to(self) -> bool:
        implementation = self._publisher.impl
        return implementation is not None and bool(implementation.connections)

    def unregister(self) -> None:
        """Take the topic off the graph."""
        self._publisher.unregister()
