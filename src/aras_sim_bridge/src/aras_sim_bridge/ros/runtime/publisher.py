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

import numpy as np
import rospy
from genpy import Message
from rospy.impl.tcpros_base import TCPROSTransport

from aras_sim_bridge.ros.runtime.send_queue import MessageParts, SendQueue

_LENGTH = struct.Struct("<I")


class SubscriberWatch(rospy.SubscribeListener):
    """Tells when the listeners of a topic come and go.

    rospy tells so from its own threads, each in its own time: who hears it looks how many there
    are now (`list_connections`), and does not reckon with what it was told.
    """

    def __init__(self, on_change: Callable[[], None]) -> None:
        super().__init__()
        self._on_change = on_change

    def peer_subscribe(self, *_args: object) -> None:
        self._on_change()

    def peer_unsubscribe(self, *_args: object) -> None:
        self._on_change()


def list_connections(publisher: rospy.Publisher | None) -> list[TCPROSTransport]:
    """The listeners' connections, without the topic's lock, which rospy holds while it tells of
    them; none while the topic is not, or no longer, advertised."""
    implementation = None if publisher is None else publisher.impl
    return [] if implementation is None else implementation.connections


class NonBlockingPublisher:
    """Publishes from one thread; listeners connect and go as with any rospy.Publisher."""

    def __init__(
        self,
        topic: str,
        message: type[Message],
        queue_size: int,
        latch: bool = False,
        on_change: Callable[[], None] = lambda: None,
    ) -> None:
        """Advertise.

        Args:
            latch: who comes later gets the last message.
            changed: called, from any thread, when listeners came or went; also before this
                returns, where somebody waited for the topic.
        """
        self._topic = topic
        self._queue_size = queue_size
        self._on_change = on_change
        self._lock = threading.Lock()
        self._queues: dict[TCPROSTransport, SendQueue] = {}
        self._latched_message: MessageParts | None = None
        self._sequence = 0
        # rospy tells listeners of the latch, but never has a message to latch: see _on_peers.
        self._latch = latch
        self._publisher: rospy.Publisher | None = None
        self._publisher = rospy.Publisher(
            topic,
            message,
            queue_size=queue_size,
            latch=latch,
            tcp_nodelay=True,
            subscriber_listener=SubscriberWatch(self._update_queues),
        )
        self._update_queues()  # of who was quicker than the constructor rospy tells nothing

    def publish(self, message: Message) -> None:
        """Send a message to those who listen; its header gets the next sequence number."""
        if self._is_needed():
            self.publish_bytes(self._serialise(message))

    def publish_array(self, message: Message, array: np.ndarray, trailing_bytes: int = 0) -> None:
        """Send a message whose empty `data` are to be an array's bytes, which go from there into
        the sockets and must not change any more; `trailing_bytes`: bytes of the fields after
        `data`."""
        body = self._serialise(message)
        end = len(body) - trailing_bytes
        head = body[: end - _LENGTH.size] + _LENGTH.pack(array.nbytes)
        self.publish_bytes(head, memoryview(array).cast("B"), body[end:])

    def _serialise(self, message: Message) -> bytes:
        if message._has_header:
            self._sequence += 1
            message.header.seq = self._sequence
        buffer = BytesIO()
        message.serialize(buffer)
        return buffer.getvalue()

    def publish_bytes(self, *body: bytes | memoryview) -> None:
        """Send a message that is serialised already, in parts that must not change any more."""
        if not self._is_needed():
            return
        parts = (_LENGTH.pack(sum(map(len, body))), *body)
        with self._lock:
            if self._latch:
                self._latched_message = parts
            for connection in list_connections(self._publisher):
                lane = self._queues.get(connection) or self._open_queue(connection)
                if lane is not None:
                    lane.send(parts)

    @property
    def subscriber_count(self) -> int:
        """Number of listeners."""
        return len(list_connections(self._publisher))

    def unregister(self) -> None:
        """Take the topic off the graph."""
        self._publisher.unregister()
        self._update_queues()

    def _is_needed(self) -> bool:
        return self._latch or self.subscriber_count > 0

    def _open_queue(self, connection: TCPROSTransport) -> SendQueue | None:
        """Return the lane of a new connection; None while it is not up."""
        if connection.socket is None:
            return None
        lane = self._queues[connection] = SendQueue(
            connection.socket,
            self._queue_size,
            lambda: self._close(connection),
            f"{connection.endpoint_id}, which does not take {self._topic}",
        )
        return lane

    def _update_queues(self) -> None:
        """Send the latched message to whoever has just come; forget what waits for who has gone."""
        with self._lock:
            present = list_connections(self._publisher)
            for connection in self._queues.keys() - set(present):
                self._queues.pop(connection).close()
            if self._latched_message is not None:
                for connection in present:
                    if connection in self._queues:
                        continue
                    if (lane := self._open_queue(connection)) is not None:
                        lane.send(self._latched_message)
        self._on_change()

    def _close(self, connection: TCPROSTransport) -> None:
        """Forget a connection that broke; not from here, where its lane is at work."""
        threading.Thread(target=self._drop, args=(connection,), daemon=True).start()

    def _drop(self, connection: TCPROSTransport) -> None:
        implementation = self._publisher.impl
        if implementation is not None:
            implementation.remove_connection(connection)
        connection.close()
