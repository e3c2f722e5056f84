"""Subscribers that come, read and leave: which messages each receives, and what is stored."""

from __future__ import annotations

import socket
import struct
import threading
from types import SimpleNamespace

import pytest
from std_msgs.msg import Float64, Header

from aras_sim_bridge.ros.runtime import publisher
from aras_sim_bridge.ros.runtime.publisher import NonBlockingPublisher
from aras_visual_servo_ros import send_queue


class Connection:
    """Connection of a subscriber with the interface of rospy."""

    def __init__(self) -> None:
        self.endpoint_id = "/listener"
        self.socket, self.far = socket.socketpair()
        self.far.settimeout(5.0)

    def close(self) -> None:
        self.socket.close()

    def bodies(self, count: int) -> list[bytes]:
        found = []
        for _ in range(count):
            (size,) = struct.unpack("<I", self._read(4))
            found.append(self._read(size))
        return found

    def _read(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            data += self.far.recv(size - len(data))
        return data


@pytest.fixture
def ros(monkeypatch):
    """rospy's side of one topic: `connections`, and `tell` for its SubscribeListener."""
    it = SimpleNamespace(impl=SimpleNamespace(connections=[]))

    class Publisher:
        def __init__(self, *_args, subscriber_listener, **_options) -> None:
            it.tell = subscriber_listener.peer_subscribe
            self.impl = it.impl

        def unregister(self) -> None:
            self.impl = None

    monkeypatch.setattr(publisher.rospy, "Publisher", Publisher)
    return it


def join(ros) -> Connection:
    connection = Connection()
    ros.impl.connections = [*ros.impl.connections, connection]
    ros.tell()
    return connection


def leave(ros, connection: Connection) -> None:
    ros.impl.connections = [c for c in ros.impl.connections if c is not connection]
    connection.close()
    ros.tell()


def test_who_comes_later_gets_the_last_message_of_a_latched_topic_once(ros):
    topic = NonBlockingPublisher("/t", Float64, 2, latch=True)
    topic.publish_bytes(b"one")
    topic.publish_bytes(b"two")
    first = join(ros)
    ros.tell()
    topic.publish_bytes(b"three")
    assert first.bodies(2) == [b"two", b"three"]
    second = join(ros)
    assert second.bodies(1) == [b"three"]


def test_without_latch_nothing_is_kept(ros):
    topic = NonBlockingPublisher("/t", Float64, 2)
    first = join(ros)
    topic.publish_bytes(b"one")
    second = join(ros)
    topic.publish_bytes(b"two")
    assert first.bodies(2) == [b"one", b"two"]
    assert second.bodies(1) == [b"two"]


def test_images_for_who_has_gone_are_let_go(ros):
    before = set(send_queue.QUEUE_FLUSHER.list_unsent())
    topic = NonBlockingPublisher("/t", Float64, 2)
    listener = join(ros)
    for _ in range(4):
        topic.publish_bytes(bytes(4_000_000))
    (queued,) = set(send_queue.QUEUE_FLUSHER.list_unsent()) - before
    assert queued.has_unsent
    leave(ros, listener)
    assert not queued.has_unsent
    assert queued not in send_queue.QUEUE_FLUSHER.list_unsent()


def test_images_on_a_topic_that_is_taken_off_are_let_go(ros):
    before = set(send_queue.QUEUE_FLUSHER.list_unsent())
    topic = NonBlockingPublisher("/t", Float64, 2)
    join(ros)
    for _ in range(4):
        topic.publish_bytes(bytes(4_000_000))
    (queued,) = set(send_queue.QUEUE_FLUSHER.list_unsent()) - before
    topic.unregister()
    assert not queued.has_unsent
    assert topic.subscriber_count == 0


def test_changes_are_told_and_who_was_quicker_than_the_constructor_is_counted(ros):
    early = Connection()
    ros.impl.connections = [early]
    told = []
    topic = NonBlockingPublisher("/t", Float64, 2, on_change=lambda: told.append(1))
    assert told
    assert topic.subscriber_count == 1
    before = len(told)
    join(ros)
    assert len(told) > before
    assert topic.subscriber_count == 2


def test_headers_are_numbered(ros):
    topic = NonBlockingPublisher("/t", Header, 2)
    message = SimpleNamespace(
        _has_header=True, header=Header(), serialize=lambda buffer: buffer.write(b"x")
    )
    topic.publish(message)  # which nobody hears
    listener = join(ros)
    for _ in range(3):
        topic.publish(message)
    assert message.header.seq == 3
    assert listener.bodies(3) == [b"x"] * 3


def test_a_connection_that_is_not_up_yet_is_sent_to_once_it_is(ros):
    topic = NonBlockingPublisher("/t", Float64, 2, latch=True)
    topic.publish_bytes(b"one")
    slow = Connection()
    up, slow.socket = slow.socket, None
    ros.impl.connections = [slow]
    ros.tell()
    topic.publish_bytes(b"two")
    slow.socket = up
    topic.publish_bytes(b"three")
    assert slow.bodies(1) == [b"three"]


def test_a_connection_that_breaks_is_taken_from_rospy_and_closed(ros):
    removed, closed = [], threading.Event()
    ros.impl.remove_connection = removed.append
    topic = NonBlockingPublisher("/t", Float64, 2)
    listener = join(ros)
    listener.far.close()
    listener.close = closed.set
    topic.publish_bytes(b"one")
    assert closed.wait(10.0) and removed == [listener]
