"""Subscription to a command topic whose messages the simulation thread reads between two steps.

rospy decodes every message in a thread of the connection. This is too slow for a client that
publishes thousands of messages per second. Here, the simulation thread takes over the socket of a
new connection, together with the bytes that rospy has already read. The thread of rospy then only
waits for the end of the connection.
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

COMPLAINT_PERIOD = 5.0  # shortest time between two log lines of one topic, s of wall time
CLOSED_PERIOD = 1.0  # interval of the checks whether rospy has closed a connection, s of wall time
_lock = threading.Lock()
_subscriptions: dict[str, _SharedSubscription] = {}
# Data of each thread of rospy: its attribute `bodies` lists the undecoded messages that the thread
# has read.
_thread_data = threading.local()


class CommandSubscriber:
    """Subscriber whose messages are handled in the simulation thread before the next step."""

    def __init__(
        self,
        topic: str,
        message: type[Message],
        on_message: Callable[[Message], None],
        thread: SimulationThread,
    ) -> None:
        """Subscribe; the simulation thread calls `on_message`, which may raise SimError."""
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
                other for other in self._subscription.command_topics if other is not self
            )
            if not self._subscription.command_topics:
                del _subscriptions[self._topic]
                self._subscription.close()

    def handle(self, message: Message) -> None:
        """Call `on_message` with a message; errors are logged at a limited rate."""
        try:
            self._on_message(message)
        except SimError as error:
            self.log_refusal(str(error))
        except USER_FAULTS as error:
            self.log_refusal(f"{type(error).__name__}: {error}")

    def log_refusal(self, reason: str) -> None:
        """Log why a message was rejected, at most once per COMPLAINT_PERIOD."""
        self._refusals += 1
        now = time.monotonic()
        if now - self._last_complaint >= COMPLAINT_PERIOD:
            more = f" ({self._refusals} refused so far)" if self._refusals > 1 else ""
            rospy.logerr("%s: %s%s", self._topic, reason, more)
            self._last_complaint = now


class _SharedSubscription:
    """The only subscription of this process to a topic, shared by CommandSubscriber objects."""

    def __init__(self, topic: str, message: type[Message], thread: SimulationThread) -> None:
        self.command_topics: tuple[CommandSubscriber, ...] = ()
        self._topic = topic
        self._message = message
        self._thread = thread
        # streams of the present connections; used in the simulation thread only
        self._streams: set[MessageStream] = set()
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
        """Make the simulation thread read the socket of a new connection, and wait for its end.

        rospy calls this method, in a thread of the connection, for each message that it has already
        read. The first call handles all of these messages; later calls return immediately.
        """
        bodies, _thread_data.bodies = _thread_data.bodies, []
        if not bodies:  # an earlier call has already taken this message
            return
        self._is_subscribed.wait()
        implementation = self._subscriber.impl
        connections = [] if implementation is None else implementation.connections
        connection: TCPROSTransport | None = next(
            (c for c in connections if c.header is message._connection_header), None
        )
        if connection is None:  # rospy has closed the connection in the meantime
            return
        rest = connection.read_buff.getvalue()
        connection.read_buff.seek(0)
        connection.read_buff.truncate(0)
        has_ended = threading.Event()

        def on_end() -> None:
            self._streams.discard(stream)
            has_ended.set()

        stream = MessageStream(connection.socket, self._on_body, on_end, bodies, rest)

        def start_stream() -> None:
            self._streams.add(stream)
            self._thread.receiver.add(stream)

        self._thread.post(start_stream)
        while not has_ended.wait(CLOSED_PERIOD) and not rospy.is_shutdown():
            if connection.done:
                self._thread.post(lambda: self._thread.receiver.remove(stream))

    def _end_streams(self) -> None:
        for stream in list(self._streams):
            self._thread.receiver.remove(stream)

    def _on_body(self, body: bytes) -> None:
        try:
            message = self._message().deserialize(body)
        except DeserializationError as error:
            reason = (f"a message of {len(body)} bytes is not a {self._message._type}: {error}; "
                      "publish this type")
            self.command_topics[0].log_refusal(reason)
            return
        for command_topic in self.command_topics:
            command_topic.handle(message)
        if self._thread.lockstep is not None:
            self._thread.lockstep.note_message(self._topic)


def make_undecoded_type(message: type[Message]) -> type[Message]:
    """Return a message type for rospy that stores the message bodies instead of decoding them."""

    def deserialize(self: Message, body: bytes) -> Message:
        _thread_data.bodies = [*getattr(_thread_data, "bodies", []), body]
        return self

    return type(message.__name__, (message,), {"__slots__": [], "deserialize": deserialize})
