"""Messages through sockets that accept them at once, later, or never."""

import contextlib
import socket
import time
import weakref

import pytest

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
    """Return a message of two parts; every byte identifies its message."""
    return bytes([n]) * 10, memoryview(Pixels(bytes([n]) * (SIZE - 10)))


def received(theirs: socket.socket, size: int) -> bytes:
    data = bytearray()
    while len(data) < size:
        data += theirs.recv(65_536)
    return bytes(data)


def test_rest_of_a_message_follows_without_another_one(line):
    lane, theirs, _, flusher = line
    lane.send(message(7))
    assert lane.has_unsent  # otherwise this test would show nothing
    assert received(theirs, SIZE) == bytes([7]) * SIZE


def test_slow_listener_gets_whole_messages_and_the_newest(line):
    lane, theirs, lost, _ = line
    start = time.monotonic()
    for n in range(1, 21):
        lane.send(message(n))
    assert time.monotonic() - start < 1.0  # the sender never waited
    data = received(theirs, (1 + QUEUE) * SIZE)
    got = [data[i] for i in range(0, len(data), SIZE)]
    assert got == [1, 19, 20]
    assert data == b"".join(bytes([n]) * SIZE for n in got)
    theirs.settimeout(0.2)
    with pytest.raises(TimeoutError):
        theirs.recv(1)
    assert not lost


def test_next_message_waits_behind_the_rest_of_the_one_before(line):
    lane, theirs, _, flusher = line
    for n in (1, 2):
        lane.send(message(n))
    assert received(theirs, 2 * SIZE) == bytes([1]) * SIZE + bytes([2]) * SIZE
    lane.send(message(3))
    assert received(theirs, SIZE) == bytes([3]) * SIZE


def test_who_is_behind_is_told_until_it_has_taken_all_or_is_given_up(line):
    lane, theirs, _, flusher = line
    lane.send(message(1))
    assert lane.has_unsent
    assert not lane.is_behind  # the socket has the beginning; the next message finds a place
    lane.send(message(2))
    assert lane.is_behind
    assert lane in flusher.list_behind()
    lane.is_abandoned = True
    assert lane not in flusher.list_behind()
    assert received(theirs, 2 * SIZE) == bytes([1]) * SIZE + bytes([2]) * SIZE
    end = time.monotonic() + 5.0
    while lane.is_abandoned and time.monotonic() < end:
        time.sleep(0.001)
    for n in (3, 4):
        lane.send(message(n))
    assert lane.is_behind  # it is waited for again


def test_somebody_is_told_when_a_socket_took_more(line):
    lane, theirs, _, flusher = line
    told = []
    flusher.on_progress = lambda: told.append(lane.has_unsent)
    lane.send(message(1))
    received(theirs, SIZE)
    end = time.monotonic() + 5.0
    while (not told or told[-1]) and time.monotonic() < end:
        time.sleep(0.001)
    assert told[-1] is False


class Sip:
    """Socket that accepts a limited number of bytes at a time."""

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
    end = time.monotonic() + 5.0
    while not lost and time.monotonic() < end:
        with contextlib.suppress(OSError):
            lane.send(message(2))
        time.sleep(0.01)
    lane.send(message(3))
    assert len(lost) == 1
    assert not lane.has_unsent


def test_what_a_closed_socket_did_not_take_is_let_go(line):
    lane, _, _, flusher = line
    images = [message(n) for n in range(1, 4)]
    gone = [weakref.ref(image[1].obj) for image in images]
    for image in images:
        lane.send(image)
    assert lane.has_unsent
    lane.socket.close()  # by rospy, which tells the publisher
    lane.close()
    assert not lane.has_unsent
    assert lane not in flusher.list_unsent()
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
