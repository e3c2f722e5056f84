"""When simulated time waits for answers, on a wall clock that the test sets."""

import contextlib
import socket

import pytest
import rosgraph
from graph_helpers import until

from aras_sim_bridge.errors import SimError
from aras_sim_bridge.ros.runtime.lockstep import Lockstep
from aras_visual_servo_ros.send_queue import QUEUE_FLUSHER, SendQueue

MS = 1_000_000


class SlowReader:
    """A subscriber that has not read a whole message that waits for it."""

    def __init__(self, name: str) -> None:
        near, self.far = socket.socketpair()
        self.queue = SendQueue(near, 10, lambda: None, name)
        while not self.queue.is_behind:
            self.queue.send((bytes(1 << 20),))

    def read(self) -> None:
        self.far.settimeout(0.02)
        while self.queue.has_unsent:
            with contextlib.suppress(TimeoutError):
                self.far.recv(1 << 20)


@pytest.fixture
def made(graph):
    """Factory of gates; `wall` is their clock, `woken` counts calls of wake."""

    def make(*topics: str, period: float = 0.0) -> Lockstep:
        make.gate = Lockstep(topics, 5.0, lambda: make.woken.append(1), period, lambda: make.wall)
        return make.gate

    make.wall = 100.0
    make.woken = []
    yield make
    for queue in QUEUE_FLUSHER.list_unsent():
        queue.close()


def test_a_round_is_over_when_the_last_topic_was_heard(made):
    gate = made("a", "b")
    for topic in ("/a", "/b"):  # what came before a round does not count
        gate.note_message(topic)
    for step in range(100):  # without a period steps begin no round
        gate.after_step(step * MS)
    assert not gate.is_closed and made.woken == []
    gate.before_frame()
    assert gate.is_closed and gate.compute_remaining() == 5.0
    for topic in ("/a", "/a", "/c"):
        gate.note_message(topic)
    assert gate.is_closed and made.woken == []
    gate.note_message("/b")
    assert not gate.is_closed and gate.compute_remaining() is None and made.woken == [1]
    gate.note_message("/a")
    gate.before_frame()
    assert gate.is_closed


def test_topics_are_listened_to_once_unless_they_are_claimed(made, graph):
    gate = made("a", "b")
    gate.claim("/a")
    gate.before_frame()
    gate.before_frame()
    assert set(graph.subscribers) == {"/b"}
    graph.subscribers["/b"](None)
    assert gate.is_closed
    gate.note_message("/a")
    assert not gate.is_closed
    gate.claim("/b")  # who subscribes by a type of its own comes in place of the listener
    assert graph.subscribers == {}
    gate.release("/b")
    gate.before_frame()
    assert set(graph.subscribers) == {"/b"}


def test_who_is_silent_too_long_is_named_once_and_left_out_until_heard(made, graph):
    gate = made("a", "b")
    graph.published = [["/b", ["/later", "/late"]], ["/a", ["/other"]]]
    gate.before_frame()
    gate.note_message("/a")
    made.wall += 4.0
    assert gate.compute_remaining() == pytest.approx(1.0)
    made.wall += 1.1
    assert gate.compute_remaining() is None
    assert not gate.is_closed
    until(lambda: graph.lines)
    assert "5 s" in graph.lines[0]
    assert "/b (published by /late, /later)" in graph.lines[0]
    assert "/a" not in graph.lines[0].replace("/later", "").replace("/late", "")
    gate.before_frame()
    gate.note_message("/a")
    assert not gate.is_closed  # not waited for any more
    gate.note_message("/b")
    gate.before_frame()
    gate.note_message("/a")
    assert gate.is_closed  # it is back


def test_time_waits_for_a_listener_that_is_behind(made, graph):
    gate = made("a")
    gate.before_frame()
    gate.note_message("/a")
    made.wall += 60.0  # paused; that wait was another
    bag = SlowReader("/bag to read /image")
    assert gate.is_closed
    assert gate.compute_remaining() == 5.0
    made.wall += 3.0
    assert gate.compute_remaining() == pytest.approx(2.0)
    del made.woken[:]
    bag.read()
    until(lambda: made.woken)
    assert not gate.is_closed
    assert gate.compute_remaining() is None
    made.wall += 60.0  # and the next wait is another
    other = SlowReader("/bag")
    assert other.queue.is_behind
    assert gate.compute_remaining() == 5.0
    assert graph.lines == []


def test_a_listener_that_takes_nothing_is_named_once_and_given_up(made, graph):
    gate = made("a")
    bag = SlowReader("/bag to read /image")
    assert gate.compute_remaining() == 5.0
    made.wall += 5.0
    assert gate.compute_remaining() is None
    assert bag.queue.is_abandoned
    assert not gate.is_closed
    until(lambda: graph.lines)
    assert "after waiting 5 s of wall time for /bag to read /image," in graph.lines[0]
    other = SlowReader("/other")  # which has time of its own
    assert other.queue.is_behind
    assert gate.compute_remaining() == 5.0
    gate.start_round()
    made.wall += 60.0
    gate.end_round()
    assert gate.compute_remaining() == 5.0 and len(graph.lines) == 1


@pytest.mark.parametrize(("answer", "told"), [
    ([["/a", ["/z", "/x"]], ["/b", ["/y"]]], "/a (published by /x, /z)"),
    ([["/b", ["/y"]]], "/a (no publisher)"), (OSError("gone"), "/a (no publisher)"),
    (rosgraph.MasterException("no"), "/a (no publisher)")])
def test_who_should_publish_is_named(made, graph, answer, told):
    graph.published = answer
    gate = made("a")
    gate.before_frame()
    made.wall += 6.0
    gate.compute_remaining()
    until(lambda: graph.lines)
    assert told in graph.lines[0]


def test_rounds_may_go_by_periods_instead_of_frames(made):
    gate = made("a", period=0.01)
    gate.before_frame()
    # A step that goes beyond begins one round, at the multiple.
    for last, first in ((9, 10), (19, 23), (29, 30)):
        assert not gate.is_closed
        gate.after_step(last * MS)
        assert not gate.is_closed
        gate.after_step(first * MS)
        assert gate.is_closed
        gate.note_message("/a")
    gate.after_step(500 * MS)
    gate.end_round()  # by a reset of time
    assert not gate.is_closed
    gate.after_step(10 * MS)
    assert gate.is_closed


@pytest.mark.parametrize(
    ("arguments", "remedy"),
    [
        (((), 5.0, 0.0), "lockstep_topics is empty"),
        ((("a",), 0.0, 0.0), "lockstep_timeout is 0; set a time above 0 s"),
        ((("a",), -1.0, 0.0), "lockstep_timeout is -1"),
        ((("a",), 5.0, -0.1), "lockstep_period is -0.1")])
def test_what_cannot_be_is_refused_with_the_remedy(graph, arguments, remedy):
    topics, timeout, period = arguments
    with pytest.raises(SimError, match=remedy):
        Lockstep(topics, timeout, lambda: None, period)
