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
from aras_sim_bridge.ros.runtime.message_receiver import BUFFER_SIZE, MessageStream
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_visual_servo_base.names import USER_FAULTS

COMPLAINT_PERIOD = 5.0  # seconds of wall time between two lines about the same fault
CLOSED_PERIOD = 1.0  # seconds of wall time between two looks whether rospy closed a connection
_lock = threading.Lock()
_subscriptions: dict[str, _SharedSubscription] = {}
_thread_data = threading.local()  # .bodies: what rospy's thread has read and nobody has taken


class CommandTopic:
    """Hands each message of a topic on in the step that it arrived before."""

    def __init__(
        self,
        topic: str,
        message: type[Message],
        on_message: Callable[[Message], None],
        thread: SimulationThread,
    ) -> None:
        """Subscribe; `on_message`, called in the simulation's thread, may raise SimError."""
        self._topic = topic
        self._on_message = on_message
        self._last_complaint = -COMPLAINT_PERIOD
        self._refusals = 0
        with _lock:
            if topic not in _subscriptions:
                _subscriptions[topic] = _SharedSubscription(topic, message, thread)
            self._subscription = _subscriptions[topic]
            self._subscription.command_topics = (*self._subscription.command_topics, self)

    def shutdown(self) -> None:
        """Unsubscribe."""
        with _lock:
            self._subscription.command_topics = tuple(
                t for t in self._subscription.command_topics if t is not self
            )
            if not self._subscription.command_topics:
                del _subscriptions[self._topic]
                self._subscription.close()

    def handle(self, message: Message) -> None:
        """Have a message taken; a fault becomes a line, at a bounded rate."""
        try:
            self._on_message(message)
        except SimError as error:
            self.log_refusal(str(error))
        except USER_FAULTS as error:
            self.log_refusal(f"{type(error).__name__}: {error}")

    def log_refusal(self, why: str) -> None:
        """Say why a message was refused."""
        self._refusals += 1
        now = time.monotonic()
        if now - self._last_complaint >= COMPLAINT_PERIOD:
            more = f" ({self._refusals} refused so far)" if self._refusals > 1 else ""
            rospy.logerr("%s: %s%s", self._topic, why, more)
            self._last_complaint = now


class _SharedSubscription:
    """The one subscription of this process to a topic, whoever takes from it."""

    def __init__(self, topic: str, message: type[Message], thread: SimulationThread) -> None:
        self.command_topics: tuple[CommandTopic, ...] = ()
        self._topic = topic
        self._message = message
        self._thread = thread
        self._streams: set[MessageStream] = set()  # the simulation's thread's
        self._is_subscribed = threading.Event()
        if thread.lockstep is not None:
            thread.lockstep.claim(topic)
        self._subscriber = rospy.Subscriber(
            topic,
            make_undecoded_type(message),
            self._adopt_connection,
            buff_size=BUFFER_SIZE,
            tcp_nodelay=True,
        )
        self._is_subscribed.set()

    def close(self) -> None:
        """Unsubscribe."""
        self._thread.post(self._end_streams)
        self._subscriber.unregister()
        if self._thread.lockstep is not None:
            self._thread.lockstep.release(self._topic)

    def _adopt_connection(self, message: Message) -> None:
        """The first messages of a connection, in rospy's thread for it."""
        bodies, _thread_data.bodies = _thread_data.bodies, []
        if not bodies:  # this one went with those that were read before it
            return
        self._is_subscribed.wait()
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

        def on_end() -> None:
            self._streams.discard(stream)
            over.set()

        stream = MessageStream(connection.socket, self._on_body, on_end, bodies, rest)

        def start_stream() -> None:
            self._streams.add(stream)
            self._thread.receiver.add(stream)

        self._thread.post(start_stream)
        while not over.wait(CLOSED_PERIOD) and not rospy.is_shutdown():
            if connection.done:
                self._thread.post(lambda: self._thread.receiver.remove(stream))

    def _end_streams(self) -> None:
        for stream in list(self._streams):
            self._thread.receiver.remove(stream)

    def _on_body(self, body: bytes) -> None:
        try:
            message = self._message().deserialize(body)
        except DeserializationError as error:
            reason = f"a message of {len(body)} bytes is no {self._message._type}: {error}"
            self.command_topics[0].log_refusal(reason)
            return
        for taker in self.command_topics:
            taker.handle(message)
        if self._thread.lockstep is not None:
            self._thread.lockstep.note_message(self._topic)


def make_undecoded_type(message: type[Message]) -> type[Message]:
    """Return a message type as rospy wants it, which keeps the bodies and decodes nothing."""

    def deserialize(self: Message, body: bytes) -> Message:
        _thread_data.bodies = [*getattr(_thread_data, "bodies", []), body]
        return self

    return type(message.__name__, (message,), {"__slots__": [], "deserialize": deserialize})
