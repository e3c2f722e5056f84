"""Messages of a command topic on their way to controllers."""

from __future__ import annotations

import struct
import sys
from io import BytesIO
from types import SimpleNamespace

import pytest
from rospy.msg import deserialize_messages
from std_msgs.msg import Float64

from aras_sim_bridge.errors import ControllerError
from aras_sim_bridge.ros.control import command_topic
from aras_sim_bridge.ros.control.command_topic import CommandTopic


class Inbox:
    """Lets all that a stream has act at once."""

    def add(self, stream) -> None:
        step = 0
        while stream.deliver(step, 8):
            step += 1
        stream.on_end()


class Thread:
    """Replacement of SimulationThread that runs jobs at once."""

    lockstep = None
    receiver = Inbox()

    def post(self, job) -> None:
        job()


@pytest.fixture
def ros(monkeypatch):
    """rospy's subscriptions, which the test counts, and lines of the log."""
    it = SimpleNamespace(open=[], lines=[])

    class Subscriber:
        def __init__(self, topic, kind, hear, **options) -> None:
            it.open.append(topic)
            it.options, it.latest = options, self
            self.kind, self.hear, self.impl = kind, hear, None

        def unregister(self) -> None:
            it.open.pop()

    monkeypatch.setattr(command_topic.rospy, "Subscriber", Subscriber)
    monkeypatch.setattr(command_topic, "_subscriptions", {})
    monkeypatch.setattr(
        command_topic.rospy, "logerr", lambda text, *args: it.lines.append(text % args)
    )
    return it


def body(value: float) -> bytes:
    buffer = BytesIO()
    Float64(value).serialize(buffer)
    return buffer.getvalue()


class Connection:
    """Replacement of rospy's connection: messages that were read, and `rest` of the next one."""

    def __init__(self, *bodies: bytes, rest: bytes = b"", comes: bytes = b"") -> None:
        self.header = {"callerid": "/somebody"}
        self.read_buff = BytesIO()
        for one in bodies:
            self.read_buff.write(struct.pack("<I", len(one)) + one)
        self.read_buff.write(rest)
        self.done = False
        self._comes = comes
        self.socket = SimpleNamespace(fileno=lambda: 5, recv_into=self._receive)

    def _receive(self, buffer: bytearray, *_how: int) -> int:
        buffer[: len(self._comes)] = self._comes
        return len(self._comes)

    def tell(self, subscriber) -> None:
        """Process the messages as rospy's thread does."""
        subscriber.impl = SimpleNamespace(connections=[self])
        for message in self.messages(subscriber.kind):
            subscriber.hear(message)

    def messages(self, kind) -> list:
        found: list = []
        deserialize_messages(self.read_buff, found, kind)
        for message in found:
            message._connection_header = self.header
        return found


def test_two_who_take_from_one_topic_both_hear_over_one_subscription(ros):
    """Two robots with one emergency stop: rospy has one connection for both."""
    heard = [], []
    first, second = (
        CommandTopic("/stop", Float64, lambda m, to=to: to.append(m.data), Thread())
        for to in heard
    )
    assert ros.open == ["/stop"]
    assert ros.options == {"buff_size": 1 << 20, "tcp_nodelay": True}
    Connection(body(1.0)).tell(ros.latest)
    assert heard == ([1.0], [1.0])
    first.shutdown()
    Connection(body(2.0)).tell(ros.latest)
    assert heard == ([1.0], [1.0, 2.0])
    second.shutdown()
    assert ros.open == []
    third = CommandTopic("/stop", Float64, lambda m: None, Thread())
    assert ros.open == ["/stop"]
    third.shutdown()


def test_what_cannot_be_taken_is_said_once_in_a_while_and_the_next_is_taken(ros):
    taken = []

    def take(message: Float64) -> None:
        if message.data < 0.0:
            raise ControllerError("below zero")
        if message.data == 0.0:
            raise ZeroDivisionError("a user's")
        if message.data == 1.0:
            sys.exit("a user's")
        taken.append(message.data)

    topic = CommandTopic("/c", Float64, take, Thread())
    for value in (-1.0, 0.0, 1.0, -1.0, 5.0):
        Connection(body(value)).tell(ros.latest)
    Connection(b"abc").tell(ros.latest)
    assert taken == [5.0]
    assert ros.lines == ["/c: below zero"]
    topic.shutdown()


def test_complaints_come_five_seconds_apart_and_count_what_was_refused(ros, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(command_topic.time, "monotonic", lambda: now[0])
    topic = CommandTopic("/c", Float64, lambda m: None, Thread())
    for now[0] in (0.0, 4.9, 5.0, 9.9):
        Connection(b"abc").tell(ros.latest)
    first, second = ros.lines
    assert first.startswith("/c: a message of 3 bytes is not a std_msgs/Float64: ")
    assert "refused" not in first and second.endswith(" (3 refused so far)")
    topic.shutdown()


def test_all_that_rospy_read_goes_with_the_connection_and_only_once(ros):
    streams, taken, thread = [], [], Thread()
    thread.receiver = SimpleNamespace(add=lambda stream: (streams.append(stream), stream.on_end()))
    CommandTopic("/c", Float64, lambda m: taken.append(m.data), thread)
    last = struct.pack("<I", 8) + body(4.0)
    connection = Connection(body(1.0), body(2.0), body(3.0), rest=last[:2], comes=last[2:])
    connection.tell(ros.latest)
    (stream,) = streams
    assert connection.read_buff.getvalue() == b"" and connection.read_buff.tell() == 0
    for step in range(3):
        stream.deliver(step, 8)
    assert taken == [1.0, 2.0, 3.0]
    assert stream.read(bytearray(64)) and stream.deliver(3, 8)  # begun by rospy, ended by us
    assert taken[3:] == [4.0]


@pytest.mark.parametrize("why", ["rospy closed it", "the node ends"])
def test_rospy_s_thread_rests_until_its_connection_ends(ros, monkeypatch, why):
    assert command_topic.CLOSED_PERIOD == 1.0
    monkeypatch.setattr(command_topic, "CLOSED_PERIOD", 0.001)
    monkeypatch.setattr(command_topic.rospy, "is_shutdown", lambda: why == "the node ends")
    streams, removed = [], []
    thread = Thread()
    thread.receiver = SimpleNamespace(
        add=streams.append, remove=lambda stream: (removed.append(stream), stream.on_end()))
    topic = CommandTopic("/c", Float64, lambda m: None, thread)
    connection, subscriber = Connection(body(1.0)), ros.latest
    connection.done = why == "rospy closed it"
    connection.tell(subscriber)
    assert removed == (streams if connection.done else [])
    topic.shutdown()  # what is left is read no more
    assert removed == streams and len(streams) == 1
    (late,) = Connection(body(1.0)).messages(subscriber.kind)
    subscriber.impl = None
    subscriber.hear(late)  # one that was closed meanwhile
    assert len(streams) == 1


class Gate:
    """Gate of the simulation thread that records its calls."""

    def __init__(self) -> None:
        self.told = []

    def claim(self, topic: str) -> None:
        self.told.append(f"claim {topic}")

    def note_message(self, topic: str) -> None:
        self.told.append(f"heard {topic}")

    def release(self, topic: str) -> None:
        self.told.append(f"release {topic}")


def test_lockstep_hears_of_a_message_when_all_have_taken_it(ros):
    thread = Thread()
    thread.lockstep = Gate()
    first, second = (
        CommandTopic("/c", Float64, lambda m: thread.lockstep.told.append(m.data), thread)
        for _ in range(2)
    )
    Connection(body(1.0)).tell(ros.latest)
    first.shutdown()
    second.shutdown()
    assert thread.lockstep.told == ["claim /c", 1.0, 1.0, "heard /c", "release /c"]
