"""Messages through sockets that accept them at once, later, or never; rospy's publishers too."""

import socket
import time
import weakref

import pytest
import rospy
from rospy.exceptions import TransportTerminated

from aras_visual_servo_ros import rospy_patches as connections
from aras_visual_servo_ros.rospy_patches import DirectConnection, send_to_others_only
from aras_visual_servo_ros.send_queue import QueueFlusher, SendQueue

SIZE = 300_000  # of a message: more than the socket below takes at once
QUEUE = 2


@pytest.fixture
def line():
    """A lane, its listener's end, the connections that were reported lost, and the flusher."""
    server = socket.create_server(("127.0.0.1", 0))
    ours = socket.socket()
    ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 32_768)
    ours.connect(server.getsockname())
    theirs, _ = server.accept()
    theirs.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 32_768)
    theirs.settimeout(5.0)
    lost, flusher = [], QueueFlusher()
    lane = SendQueue(ours, QUEUE, lambda: lost.append(ours), flusher=flusher)
    yield lane, theirs, lost, flusher
    lane.close()
    for end in (ours, theirs, server):
        end.close()


class Pixels(bytearray):
    """Pixels of an image, which support weak references."""


def message(n: int) -> tuple[bytes, memoryview]:
    return bytes([n]) * 10, memoryview(Pixels(bytes([n]) * (SIZE - 10)))


def received(end: socket.socket, size: int) -> bytes:
    data = bytearray()
    while len(data) < size:
        data += end.recv(size - len(data))
    return bytes(data)


def until(predicate) -> None:
    end = time.monotonic() + 5.0
    while not predicate() and time.monotonic() < end:
        time.sleep(0.001)


def test_who_is_behind_is_told_until_it_has_taken_all_or_is_given_up(line):
    lane, theirs, _, flusher = line
    told = []
    flusher.on_progress = lambda: told.append(lane.has_unsent)
    lane.send(message(1))
    assert lane.has_unsent
    assert not lane.is_behind  # the socket has the beginning; the next message finds a place
    lane.send(message(2))
    assert lane.is_behind and lane in flusher.list_behind()
    lane.is_abandoned = True
    assert lane not in flusher.list_behind()
    for n in (1, 2):  # the rest follows without another message
        assert received(theirs, SIZE) == bytes([n]) * SIZE
    until(lambda: told and not told[-1])
    assert told[-1] is False
    until(lambda: not lane.is_abandoned)
    for n in (3, 4):
        lane.send(message(n))
    assert lane.is_behind  # it is waited for again


class Sip:
    def __init__(self, most: int) -> None:
        self.most, self.taken = most, b""

    def fileno(self) -> int:
        return -1  # nobody but the test asks it for more

    def sendmsg(self, parts, _ancillary, _flags) -> int:
        some = b"".join(map(bytes, parts))[: self.most]
        self.taken += some
        return len(some)


@pytest.mark.parametrize("most", range(1, 13))
def test_every_byte_goes_once_wherever_a_socket_stops(most):
    sip = Sip(most)
    lane = SendQueue(sip, QUEUE, lambda: None)
    lane.send((b"0123", memoryview(b"45"), b"6789"))
    for _ in range(10):
        lane.flush()
    assert sip.taken == b"0123456789" and not lane.has_unsent


def test_lost_listener_is_reported_once(line):
    lane, theirs, lost, _ = line
    lane.send(message(1))
    theirs.close()
    until(lambda: lane.send(message(2)) or lost)
    lane.send(message(3))
    assert len(lost) == 1 and not lane.has_unsent


def test_what_a_closed_socket_did_not_take_is_let_go(line):
    lane, _, _, flusher = line
    images = [message(n) for n in range(1, 4)]
    gone = [weakref.ref(image[1].obj) for image in images]
    for image in images:
        lane.send(image)
    assert lane.has_unsent
    lane.socket.close()  # by rospy, which tells the publisher
    lane.close()
    assert not lane.has_unsent and lane not in flusher.list_unsent()
    del image, images
    assert [reference() for reference in gone] == [None] * 3
    lane.send(message(9))
    assert not lane.has_unsent


def test_a_lane_with_the_number_of_a_closed_one_keeps_its_turn(line):
    first, _, _, flusher = line
    first.send(message(1))
    second = SendQueue(first.socket, QUEUE, lambda: None, flusher=flusher)
    second.send(message(2))
    first.close()
    assert second in flusher.list_unsent()


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
        return received(self.far, size)


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
    gone, slow = Transport(), Transport()
    connection = DirectConnection(gone, 10)
    gone.far.close()
    with pytest.raises(TransportTerminated, match="/listener has disconnected"):
        connection.write_data(b"one")
    connection.close()
    assert connection.done
    connection = DirectConnection(slow, 10)  # whose waiting messages are dropped at its end
    for _ in range(2):
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
        connection = DirectConnection(transport, 10)
        assert all(connection.write_data(data) for data in (b"one", b"two", b"three"))
    assert other.read(11) == b"onetwothree"
    assert (connection.stat_num_msg, connection.stat_bytes) == (3, 11)
    assert connection.endpoint_id == "/recorder" and not connection.done
    own.far.settimeout(0.1)
    with pytest.raises(TimeoutError):
        own.far.recv(1)
