"""Messages of a command topic on their way to controllers."""

from __future__ import annotations

import socket
import struct
import time
from io import BytesIO

import pytest
import rospy
from rospy.msg import deserialize_messages
from std_msgs.msg import Float64

from aras_sim_bridge.errors import ControllerError
from aras_sim_bridge.ros.control.command_subscriber import CommandSubscriber
from aras_sim_bridge.ros.runtime.lockstep import Lockstep
from aras_sim_bridge.ros.runtime.message_receiver import MessageReceiver
from aras_sim_bridge.ros.runtime.pacing import Pacer
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.simulation import Simulation
from aras_visual_servo_ros.send_queue import QueueFlusher


class Inbox(MessageReceiver):
    """Lists its streams; what a stream has acts at once if it `delivers`, and the stream `ends`."""

    def __init__(self, delivers: bool, ends: bool) -> None:
        super().__init__()
        self.delivers, self.ends, self.streams, self.removed = delivers, ends, [], []

    def add(self, stream) -> None:
        self.streams.append(stream)
        step = 0
        while self.delivers and stream.deliver(step, 8):
            step += 1
        if self.ends:
            stream.on_end()

    def remove(self, stream) -> None:
        self.removed.append(stream)
        stream.on_end()


class Thread(SimulationThread):
    def __init__(self, delivers: bool = True, ends: bool = True) -> None:
        super().__init__(Simulation, Pacer(1.0), receiver=Inbox(delivers, ends))

    def post(self, job) -> None:
        job()


@pytest.fixture
def ros(monkeypatch):
    """rospy's subscriptions: the open ones, options and object of the last one, and log lines."""

    class Subscriber:
        open, lines, options, latest = [], [], {}, None

        def __init__(self, topic, kind, hear, **options) -> None:
            self.open.append(topic)
            Subscriber.options, Subscriber.latest = options, self
            self.kind, self.hear, self.impl, self.connections = kind, hear, None, []

        def unregister(self) -> None:
            self.open.pop()

    monkeypatch.setattr(rospy, "Subscriber", Subscriber)
    monkeypatch.setattr(rospy, "logerr", lambda text, *args: Subscriber.lines.append(text % args))
    return Subscriber


def body(value: float) -> bytes:
    buffer = BytesIO()
    Float64(value).serialize(buffer)
    return buffer.getvalue()


class Connection:
    """rospy's connection: messages that were read, `rest` of the next one, and what `comes`."""

    def __init__(self, *bodies: bytes, rest: bytes = b"", comes: bytes = b"") -> None:
        self.header, self.done = {"callerid": "/somebody"}, False
        self.read_buff = BytesIO()
        self.read_buff.write(b"".join(struct.pack("<I", len(b)) + b for b in bodies) + rest)
        self.socket, self.far = socket.socketpair()
        self.far.sendall(comes)

    def tell(self, subscriber) -> None:
        subscriber.impl, subscriber.connections = subscriber, [self]
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
        CommandSubscriber("/stop", Float64, lambda m, to=to: to.append(m.data), Thread())
        for to in heard
    )
    assert ros.open == ["/stop"]
    assert ros.options == {"buff_size": 1 << 20, "tcp_nodelay": True}
    Connection(body(1.0)).tell(ros.latest)
    first.shutdown()
    Connection(body(2.0)).tell(ros.latest)
    assert heard == ([1.0], [1.0, 2.0])
    second.shutdown()
    assert ros.open == []
    third = CommandSubscriber("/stop", Float64, lambda m: None, Thread())
    assert ros.open == ["/stop"]
    third.shutdown()


def test_what_cannot_be_taken_is_said_once_in_a_while_and_the_next_is_taken(ros, monkeypatch):
    taken, now = [], [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    faults = {-1.0: ControllerError("below zero"), 0.0: ZeroDivisionError("a user's"),
              1.0: SystemExit("a user's")}

    def take(message: Float64) -> None:
        if message.data in faults:
            raise faults[message.data]
        taken.append(message.data)

    topic = CommandSubscriber("/c", Float64, take, Thread())
    for value in (-1.0, 0.0, 1.0, -1.0, 5.0):
        Connection(body(value)).tell(ros.latest)
    assert taken == [5.0] and ros.lines == ["/c: below zero"]
    for now[0] in (4.9, 5.0, 9.9):  # five seconds apart, with how many were refused
        Connection(b"abc").tell(ros.latest)
    (_, second) = ros.lines
    assert second.startswith("/c: a message of 3 bytes is not a std_msgs/Float64: ")
    assert second.endswith(" (6 refused so far)")
    topic.shutdown()


def test_all_that_rospy_read_goes_with_the_connection_and_only_once(ros):
    taken, thread = [], Thread(delivers=False)
    topic = CommandSubscriber("/c", Float64, lambda m: taken.append(m.data), thread)
    last = struct.pack("<I", 8) + body(4.0)
    connection = Connection(body(1.0), body(2.0), body(3.0), rest=last[:2], comes=last[2:])
    connection.tell(ros.latest)
    (stream,) = thread.receiver.streams
    assert connection.read_buff.getvalue() == b"" and connection.read_buff.tell() == 0
    for step in range(3):
        stream.deliver(step, 8)
    assert taken == [1.0, 2.0, 3.0]
    assert stream.read(bytearray(64)) and stream.deliver(3, 8)  # begun by rospy, ended by us
    assert taken[3:] == [4.0]
    topic.shutdown()


@pytest.mark.parametrize("why", ["rospy closed it", "the node ends"])
def test_rospy_s_thread_rests_until_its_connection_ends(ros, monkeypatch, why):
    monkeypatch.setattr(rospy, "is_shutdown", lambda: why == "the node ends")
    thread = Thread(delivers=False, ends=False)
    inbox = thread.receiver
    topic = CommandSubscriber("/c", Float64, lambda m: None, thread)
    connection, subscriber = Connection(body(1.0)), ros.latest
    connection.done = why == "rospy closed it"
    connection.tell(subscriber)
    assert inbox.removed == (inbox.streams if connection.done else [])
    topic.shutdown()  # what is left is read no more
    assert inbox.removed == inbox.streams and len(inbox.streams) == 1
    (late,) = Connection(body(1.0)).messages(subscriber.kind)
    subscriber.impl = None
    subscriber.hear(late)  # one that was closed meanwhile
    assert len(inbox.streams) == 1


def test_lockstep_hears_of_a_message_when_all_have_taken_it(ros):
    thread, taken = Thread(), []
    thread.lockstep = gate = Lockstep(["/c"], 1.0, lambda: None, flusher=QueueFlusher())
    first, second = (
        CommandSubscriber("/c", Float64, lambda m: taken.append((m.data, gate.is_closed)), thread)
        for _ in range(2)
    )
    gate.start_round()
    Connection(body(1.0)).tell(ros.latest)
    assert taken == [(1.0, True)] * 2 and not gate.is_closed
    first.shutdown()
    gate.start_round()
    assert ros.open == ["/c"]  # which is still claimed
    second.shutdown()
    gate.start_round()
    assert ros.open == ["/c"]  # the gate's own
    assert ros.latest.kind is rospy.AnyMsg
