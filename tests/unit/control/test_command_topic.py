"""Messages of a command topic on their way to controllers."""

from __future__ import annotations

import sys
from io import BytesIO
from types import SimpleNamespace

import pytest
from rospy.msg import deserialize_messages, serialize_message
from std_msgs.msg import Float64

from aras_sim_bridge.errors import ControllerError
from aras_sim_bridge.ros.control import command_topic
from aras_sim_bridge.ros.control.command_topic import CommandTopic, undecoded


class Thread:
    """As SimulationThread; jobs are done at once."""

    gate = None

    def post(self, job) -> None:
        job()


@pytest.fixture
def ros(monkeypatch):
    """rospy's subscriptions, which the test counts, and lines of the log."""
    it = SimpleNamespace(open=[], lines=[])

    class Subscriber:
        def __init__(self, topic, *_args, **options) -> None:
            it.open.append(topic)
            it.options = options

        def unregister(self) -> None:
            it.open.pop()

    monkeypatch.setattr(command_topic.rospy, "Subscriber", Subscriber)
    monkeypatch.setattr(command_topic, "_feeds", {})
    monkeypatch.setattr(
        command_topic.rospy, "logerr", lambda text, *args: it.lines.append(text % args)
    )
    return it


def send(topic: CommandTopic, value: float) -> None:
    buffer = BytesIO()
    Float64(value).serialize(buffer)
    topic._feed._on_body(buffer.getvalue())


def test_two_who_take_from_one_topic_both_hear_over_one_subscription(ros):
    """Two robots with one emergency stop: rospy has one connection for both."""
    heard = [], []
    first, second = (
        CommandTopic("/stop", Float64, lambda m, to=to: to.append(m.data), Thread())
        for to in heard
    )
    assert ros.open == ["/stop"]
    assert ros.options == {"buff_size": 1 << 20, "tcp_nodelay": True}
    send(first, 1.0)
    assert heard == ([1.0], [1.0])
    first.shutdown()
    send(second, 2.0)
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
        send(topic, value)
    topic._feed._on_body(b"abc")
    assert taken == [5.0]
    assert ros.lines == ["/c: below zero"]
    topic.shutdown()


def test_complaints_come_five_seconds_apart_and_count_what_was_refused(ros, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(command_topic.time, "monotonic", lambda: now[0])
    topic = CommandTopic("/c", Float64, lambda m: None, Thread())
    for now[0] in (0.0, 4.9, 5.0, 9.9):
        topic._feed._on_body(b"abc")
    first, second = ros.lines
    assert first.startswith("/c: a message of 3 bytes is no std_msgs/Float64: ")
    assert "refused" not in first and second.endswith(" (3 refused so far)")
    topic.shutdown()


class Connection:
    """As rospy's, with what its thread has read."""

    def __init__(self, *values: float) -> None:
        self.header = {"callerid": "/somebody"}
        self.read_buff = BytesIO()
        self.socket = SimpleNamespace(fileno=lambda: 5)
        self.done = False
        for value in values:
            serialize_message(self.read_buff, 0, Float64(value))
        self.read_buff.write(b"ab")  # of the next one

    def messages(self) -> list:
        """As rospy reads them."""
        found = []
        deserialize_messages(self.read_buff, found, undecoded(Float64))
        for message in found:
            message._connection_header = self.header
        return found


def test_all_that_rospy_read_goes_with_the_connection_and_only_once(ros, monkeypatch):
    streams = []
    thread = Thread()
    thread.inbox = SimpleNamespace(add=lambda stream: (streams.append(stream), stream.ended()))
    taken = []
    topic = CommandTopic("/c", Float64, lambda m: taken.append(m.data), thread)
    connection = Connection(1.0, 2.0, 3.0)
    topic._feed._subscriber = SimpleNamespace(impl=SimpleNamespace(connections=[connection]))
    messages = connection.messages()
    assert len(messages) == 3
    for message in messages:
        topic._feed._hand_over(message)
    assert len(streams) == 1
    for step in range(3):
        streams[0].act(step, 8)
    assert taken == [1.0, 2.0, 3.0]
    assert streams[0]._rest == b"ab"
    assert connection.read_buff.getvalue() == b"" and connection.read_buff.tell() == 0


@pytest.mark.parametrize("why", ["rospy closed it", "the node ends"])
def test_rospy_s_thread_rests_until_its_connection_ends(ros, monkeypatch, why):
    assert command_topic.CLOSED_PERIOD == 1.0
    monkeypatch.setattr(command_topic, "CLOSED_PERIOD", 0.001)
    monkeypatch.setattr(command_topic.rospy, "is_shutdown", lambda: why == "the node ends")
    streams, removed = [], []
    thread = Thread()
    thread.inbox = SimpleNamespace(
        add=streams.append, remove=lambda stream: (removed.append(stream), stream.ended()))
    topic = CommandTopic("/c", Float64, lambda m: None, thread)
    connection = Connection(1.0)
    connection.done = why == "rospy closed it"
    topic._feed._subscriber.impl = SimpleNamespace(connections=[connection])
    (message,) = connection.messages()
    topic._feed._hand_over(message)
    assert removed == (streams if connection.done else [])
    topic.shutdown()  # what is left is read no more
    assert removed == streams and len(streams) == 1
    (late,) = Connection(1.0).messages()
    topic._feed._subscriber.impl = None
    topic._feed._hand_over(late)  # one that was closed meanwhile
    assert len(streams) == 1


class Gate:
    """Notes what it is told of."""

    def __init__(self) -> None:
        self.told = []

    def claim(self, topic: str) -> None:
        self.told.append(f"claim {topic}")

    def heard(self, topic: str) -> None:
        self.told.append(f"heard {topic}")

    def release(self, topic: str) -> None:
        self.told.append(f"release {topic}")


def test_lockstep_hears_of_a_message_when_all_have_taken_it(ros):
    thread = Thread()
    thread.gate = Gate()
    first, second = (
        CommandTopic("/c", Float64, lambda m: thread.gate.told.append(m.data), thread)
        for _ in range(2)
    )
    send(first, 1.0)
    first.shutdown()
    second.shutdown()
    assert thread.gate.told == ["claim /c", 1.0, 1.0, "heard /c", "release /c"]
