"""rospy's publishers write to their subscribers' sockets directly, and never wait for them."""

from __future__ import annotations

import socket

import pytest
import rospy
from rospy.exceptions import TransportTerminated

from aras_visual_servo_ros import rospy_patches as connections
from aras_visual_servo_ros.rospy_patches import DirectConnection, send_to_others_only

SIZE = 400_000  # of a message: more than a socket takes at once


class Transport:
    """Connection of rospy to a subscriber; the test reads from `far`."""

    def __init__(self, endpoint: str = "/listener") -> None:
        self.endpoint_id, self.name, self.done = endpoint, "/arm/command", False
        self.stat_bytes = self.stat_num_msg = 0
        self.socket, self.far = socket.socketpair()
        self.far.settimeout(5.0)

    def set_cleanup_callback(self, callback) -> None:
        self.cleanup = callback

    def close(self) -> None:
        self.done = True
        self.socket.close()
        self.cleanup(self)

    def read(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            data += self.far.recv(size - len(data))
        return data


def test_messages_arrive_in_order_and_are_counted():
    transport = Transport()
    connection = DirectConnection(transport, 10)
    for data in (b"one", b"two", b"three"):
        assert connection.write_data(data)
    assert transport.read(11) == b"onetwothree"
    assert (connection.stat_num_msg, connection.stat_bytes) == (3, 11)
    assert connection.endpoint_id == "/listener" and not connection.done


@pytest.mark.parametrize(("queue_size", "arrive"), [(2, [0, 8, 9]), (0, list(range(10)))])
def test_a_slow_subscriber_gets_whole_messages_and_the_newest(queue_size, arrive):
    transport = Transport()
    connection = DirectConnection(transport, queue_size)
    for number in range(10):
        connection.write_data(bytes([number]) * SIZE)
    for number in arrive:
        assert transport.read(SIZE) == bytes([number]) * SIZE
    transport.far.settimeout(0.1)
    with pytest.raises(TimeoutError):
        transport.far.recv(1)


def test_a_subscriber_that_has_gone_is_reported_as_rospy_does():
    transport = Transport()
    connection = DirectConnection(transport, 10)
    transport.far.close()
    with pytest.raises(TransportTerminated, match="/listener has disconnected"):
        connection.write_data(b"one")
    connection.close()
    assert connection.done


def test_waiting_messages_are_dropped_when_rospy_closes_the_connection():
    transport = Transport()
    connection = DirectConnection(transport, 10)
    connection.write_data(bytes(SIZE))
    connection.write_data(bytes(SIZE))
    (queue,) = (one for one in connections._flusher.list_unsent() if one.name == "/listener")
    connection.close()
    assert not queue.has_unsent and queue not in connections._flusher.list_unsent()


def test_own_messages_are_left_out_where_only_those_of_others_are_wanted(monkeypatch):
    monkeypatch.setattr(rospy, "get_name", lambda: "/listener")
    monkeypatch.setattr(connections, "_topics_for_others", set())
    send_to_others_only("/arm/command")
    own, other = Transport(), Transport("/recorder")
    for transport in (own, other):
        assert DirectConnection(transport, 10).write_data(b"one")
    assert other.read(3) == b"one"
    own.far.settimeout(0.1)
    with pytest.raises(TimeoutError):
        own.far.recv(1)
