"""A topic whose messages are commands: read by the simulation's thread itself, between two steps.

rospy gives every connection a thread, which would decode 6 000 messages a second of an original
node's loop without sleep. Here that thread hands over its connection, with what it has read, and
rests until the connection ends; see runtime.inbox for what becomes of the messages.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import rospy
from genpy import DeserializationError, Message
from rospy.impl.tcpros_base import TCPROSTransport

from aras_sim_bridge.errors import SimError
from aras_sim_bridge.ros.runtime.inbox import BUFFER_SIZE, Stream
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_visual_servo_base.names import USER_FAULTS

COMPLAINT_PERIOD = 5.0  # seconds of wall time between two lines about the same fault
CLOSED_PERIOD = 1.0  # seconds of wall time between two looks whether rospy closed a connection
_lock = threading.Lock()
_feeds: dict[str, _Feed] = {}
_read = threading.local()  # .bodies: what rospy's thread has read and nobody has taken


class CommandTopic:
    """Hands each message of a topic on in the step that it arrived before."""

    def __init__(
        self,
        topic: str,
        message: type[Message],
        take: Callable[[Message], None],
        thread: SimulationThread,
    ) -> None:
        """Subscribe; `take`, called in the simulation's thread, may raise SimError."""
        self._topic = topic
        self._take = take
        self._complained = -COMPLAINT_PERIOD
        self._refused = 0
        with _lock:
            if topic not in _feeds:
                _feeds[topic] = _Feed(topic, message, thread)
            self._feed = _feeds[topic]
            self._feed.takers = (*self._feed.takers, self)

    def shutdown(self) -> None:
        """Unsubscribe."""
        with _lock:
            self._feed.takers = tuple(t for t in self._feed.takers if t is not self)
            if not self._feed.takers:
                del _feeds[self._topic]
                self._feed.close()

    def act(self, message: Message) -> None:
        """Have a message taken; a fault becomes a line, at a bounded rate."""
        try:
            self._take(message)
        except SimError as error:
            self.complain(str(error))
        except USER_FAULTS as error:
            self.complain(f"{type(error).__name__}: {error}")

    def complain(self, why: str) -> None:
        """Say why a message was refused."""
        self._refused += 1
        now = time.monotonic()
        if now - self._complained >= COMPLAINT_PERIOD:
            more = f" ({self._refused} refused so far)" if self._refused > 1 else ""
            rospy.logerr("%s: %s%s", self._topic, why, more)
            self._complained = now


class _Feed:
    """The one subscription of this process to a topic, whoever takes from it."""

    def __init__(self, topic: str, message: type[Message], thread: SimulationThread) -> None:
        self.takers: tuple[CommandTopic, ...] = ()
        self._topic = topic
        self._message = message
        self._thread = thread
        self._streams: set[Stream] = set()  # the simulation's thread's
        self._subscribed = threading.Event()
        if thread.gate is not None:
            thread.gate.claim(topic)
        self._subscriber = rospy.Subscriber(
            topic,
            undecoded(message),
            self._hand_over,
            buff_size=BUFFER_SIZE,
            tcp_nodelay=True,
        )
        self._subscribed.set()

    def close(self) -> None:
        """Unsubscribe."""
        self._thread.post(self._end_streams)
        self._subscriber.unregister()
        if self._thread.gate is not None:
            self._thread.gate.release(self._topic)

    def _hand_over(self, message: Message) -> None:
        """The first messages of a connection, in rospy's thread for it."""
        bodies, _read.bodies = _read.bodies, []
        if not bodies:  # this one went with those that were read before it
            return
        self._subscribed.wait()
        implementation = self._subscriber.impl
        connections = [] if implementation is None else implementation.connections
        connection: TCPROSTransport | None = next(
            (c for c in connections if c.header is message._connection_header), None
        )
        if connection is None:  # closed meanwhile
            return
        rest = connection.read_buff.getvalue()
        connection.read_buff.seek(0)
        connection.read_buff.truncate(0)
        over = threading.Event()

        def end() -> None:
            self._streams.discard(stream)
            over.set()

        stream = Stream(connection.socket, self._on_body, end, bodies, rest)

        def begin() -> None:
            self._streams.add(stream)
            self._thread.inbox.add(stream)

        self._thread.post(begin)
        while not over.wait(CLOSED_PERIOD) and not rospy.is_shutdown():
            if connection.done:
                self._thread.post(lambda: self._thread.inbox.remove(stream))

    def _end_streams(self) -> None:
        for stream in list(self._streams):
            self._thread.inbox.remove(stream)

    def _on_body(self, body: bytes) -> None:
        try:
            message = self._message().deserialize(body)
        except DeserializationError as error:
            reason = f"a message of {len(body)} bytes is no {self._message._type}: {error}"
            self.takers[0].complain(reason)
            return
        for taker in self.takers:
            taker.act(message)
        if self._thread.gate is not None:
            self._thread.gate.heard(self._topic)


def undecoded(message: type[Message]) -> type[Message]:
    """Return a message type as rospy wants it, which keeps the bodies and decodes nothing."""

    def deserialize(self: Message, body: bytes) -> Message:
        _read.bodies = [*getattr(_read, "bodies", []), body]
        return self

    return type(message.__name__, (message,), {"__slots__": [], "deserialize": deserialize})
