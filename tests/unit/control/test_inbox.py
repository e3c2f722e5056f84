"""Command sockets that the simulation's thread reads: which message acts in which step."""

from __future__ import annotations

import socket
import struct
import threading

import pytest

from aras_sim_bridge.ros.runtime import message_receiver

STEP_NS = 1_000_000


class Publisher:
    """The other end of a stream; `acted` lists what acted, `ended` says that it is over."""

    def __init__(self, inbox: message_receiver.MessageReceiver) -> None:
        self.end, self.ours = socket.socketpair()
        self.acted: list[int] = []
        self.ended = threading.Event()
        self.stream = message_receiver.MessageStream(
            self.ours, lambda body: self.acted.append(int(body)), self.ended.set)
        inbox.add(self.stream)

    def send(self, *numbers: int) -> None:
        self.end.sendall(b"".join(map(framed, numbers)))


def framed(number: int) -> bytes:
    body = str(number).encode()
    return struct.pack("<I", len(body)) + body


@pytest.fixture
def inbox():
    box = message_receiver.MessageReceiver()
    yield box
    box.close()


@pytest.mark.parametrize("begin", [0, 1])
def test_messages_act_in_order_one_a_step_however_often_it_is_looked_for(inbox, begin):
    publisher = Publisher(inbox)
    publisher.send(1, 2, 3)
    for step in range(3):
        assert inbox.deliver(begin + step * STEP_NS, 2)
        assert not inbox.deliver(begin + step * STEP_NS, 2)
        assert publisher.acted == [1, 2, 3][: step + 1]
    assert not inbox.deliver(begin + 3 * STEP_NS, 2)


def test_what_is_passed_over_is_counted_by_stream_until_it_is_asked_for(inbox):
    first, second = Publisher(inbox), Publisher(inbox)
    first.send(*range(6))
    second.send(*range(9))
    inbox.deliver(0, 1)
    assert second.stream.skipped_count == 7 and inbox.take_skipped_count() == 7
    assert inbox.take_skipped_count() == 0
    inbox.deliver(STEP_NS, 1)
    assert inbox.take_skipped_count() == 0
    first.send(*range(4))
    inbox.deliver(2 * STEP_NS, 0)
    assert inbox.take_skipped_count() == 3


def test_without_backlog_the_newest_and_always_the_last_word_act_in_the_step(inbox):
    publisher = Publisher(inbox)
    publisher.send(1, 2, 3)
    inbox.deliver(0, 0)
    publisher.send(4)
    inbox.deliver(0, 0)
    assert publisher.acted == [3, 4]
    publisher.send(5, 6)
    publisher.end.close()
    assert inbox.deliver(0, 8) or inbox.deliver(0, 8)  # the message, then the end
    inbox.deliver(STEP_NS, 8)
    assert publisher.acted[-1] == 6 and publisher.ended.is_set()


def test_a_message_in_pieces_and_one_that_is_too_long(inbox):
    assert message_receiver.LARGEST_MESSAGE == 16 * message_receiver.BUFFER_SIZE == 16 << 20
    long, mad, sane = (Publisher(inbox) for _ in range(3))
    long.end.sendall(struct.pack("<I", message_receiver.LARGEST_MESSAGE))
    mad.end.sendall(struct.pack("<I", message_receiver.LARGEST_MESSAGE + 1))
    sane.send(1)
    inbox.deliver(0, 1)
    assert [one.ended.is_set() for one in (long, mad, sane)] == [False, True, False]
    assert sane.acted == [1]
    publisher = Publisher(inbox)
    data = framed(12345) + framed(678)
    for k in range(len(data)):
        publisher.end.sendall(data[k : k + 1])
        inbox.deliver(k * STEP_NS, 1)
        assert publisher.acted == [12345] * (k >= 8) + [678] * (k >= 15)


def test_a_socket_closed_under_it_is_no_fault(inbox):
    publisher = Publisher(inbox)
    publisher.ours.close()
    inbox.deliver(0, 1)
    other = Publisher(inbox)  # likely under the same number
    for number in (5, 6):
        other.send(number)
        inbox.deliver(number * STEP_NS, 1)
        inbox.remove(publisher.stream)
        assert publisher.ended.is_set() and other.acted[-1] == number
    acted, ended, (ours, _) = [], threading.Event(), socket.socketpair()
    ours.close()  # before it is read
    inbox.add(message_receiver.MessageStream(ours, acted.append, ended.set, [b"1"]))
    assert ended.is_set() and not inbox.deliver(0, 0) and not acted


def test_a_command_wakes_and_so_does_the_bell(inbox):
    box = message_receiver.MessageReceiver()
    publisher = Publisher(box)
    assert not box.wait(0.0)
    publisher.send(1)
    assert box.wait(10.0) is True
    assert box.wait(0.0, commands=False) is False
    box.close()  # all streams end with it
    assert publisher.ended.is_set() and not box.deliver(0, 0) and not publisher.acted
    inbox.wake()
    inbox.wake()
    assert not inbox.wait(None)  # it was the bell, no command
    inbox.clear_wake()
    ringing = threading.Timer(0.01, inbox.wake)
    ringing.start()
    inbox.wait(None)  # for ever, if not for the bell
    ringing.join()
