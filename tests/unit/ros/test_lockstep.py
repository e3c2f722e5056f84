"""When simulated time waits for answers, on a wall clock that the test sets."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from aras_sim_bridge.errors import SimError
from aras_sim_bridge.ros.runtime import lockstep
from aras_sim_bridge.ros.runtime.lockstep import Lockstep

MS = 1_000_000


class Inline:
    """A thread that is done at once."""

    def __init__(self, target, args, daemon) -> None:
        self.start = lambda: target(*args)


@pytest.fixture
def ros(monkeypatch):
    """Subscriptions by topic, lines of the log, and who publishes."""
    it = SimpleNamespace(subscribed={}, lines=[], publishers={})

    class Subscriber:
        def __init__(self, topic, _kind, callback, **options) -> None:
            assert topic not in it.subscribed and options == {"tcp_nodelay": True}
            it.subscribed[topic] = callback
            self.unregister = lambda: it.subscribed.pop(topic)

    monkeypatch.setattr(lockstep.rospy, "Subscriber", Subscriber)
    monkeypatch.setattr(lockstep.rospy, "resolve_name", lambda name: "/" + name.lstrip("/"))
    monkeypatch.setattr(
        lockstep.rospy, "logwarn", lambda text, *args: it.lines.append(text % args)
    )
    monkeypatch.setattr(lockstep.threading, "Thread", Inline)
    it.sender = lockstep.find_publishers
    monkeypatch.setattr(lockstep, "find_publishers", lambda topics: it.publishers)
    return it


@pytest.fixture
def made(ros):
    """Factory of gates; `wall` is their clock, `woken` counts calls of wake."""

    def make(*topics: str, period: float = 0.0) -> Lockstep:
        make.gate = Lockstep(
            topics, 5.0, lambda: make.woken.append(1), period, lambda: make.wall, make.flusher
        )
        return make.gate

    make.wall = 100.0
    make.woken = []
    make.is_slow = []
    make.flusher = SimpleNamespace(
        list_behind=lambda: [lane for lane in make.is_slow if not lane.is_abandoned]
    )
    return make


def test_a_round_is_over_when_the_last_topic_was_heard(made):
    gate = made("a", "b")
    assert not gate.is_closed
    gate.before_frame()
    assert gate.is_closed
    assert gate.compute_remaining() == 5.0
    gate.note_message("/a")
    gate.note_message("/a")
    gate.note_message("/c")
    assert gate.is_closed
    assert made.woken == []
    gate.note_message("/b")
    assert not gate.is_closed
    assert gate.compute_remaining() is None
    assert made.woken == [1]


def test_what_came_before_a_round_does_not_count(made):
    gate = made("a")
    gate.note_message("/a")
    assert made.woken == []
    gate.before_frame()
    assert gate.is_closed
    gate.note_message("/a")
    gate.before_frame()
    assert gate.is_closed


def test_topics_are_listened_to_once_unless_they_are_claimed(made, ros):
    gate = made("a", "b")
    gate.claim("/a")
    gate.before_frame()
    gate.before_frame()
    assert set(ros.subscribed) == {"/b"}
    ros.subscribed["/b"](None)
    assert gate.is_closed
    gate.note_message("/a")
    assert not gate.is_closed
    gate.claim("/b")  # who subscribes by a type of its own comes in place of the listener
    assert ros.subscribed == {}
    gate.release("/b")
    gate.before_frame()
    assert set(ros.subscribed) == {"/b"}


def test_who_is_silent_too_long_is_named_once_and_left_out_until_heard(made, ros):
    gate = made("a", "b")
    ros.publishers = {"/b": ["/late", "/later"]}
    gate.before_frame()
    gate.note_message("/a")
    made.wall += 4.0
    assert gate.compute_remaining() == pytest.approx(1.0)
    made.wall += 1.1
    assert gate.compute_remaining() is None
    assert not gate.is_closed
    assert len(ros.lines) == 1
    assert "5 s" in ros.lines[0]
    assert "/b (published by /late, /later)" in ros.lines[0]
    assert "/a" not in ros.lines[0].replace("/later", "").replace("/late", "")
    gate.before_frame()
    gate.note_message("/a")
    assert not gate.is_closed  # not waited for any more
    gate.note_message("/b")
    gate.before_frame()
    gate.note_message("/a")
    assert gate.is_closed  # it is back


def test_time_waits_for_a_listener_that_is_behind(made, ros):
    gate = made("a")
    gate.before_frame()
    gate.note_message("/a")
    made.wall += 60.0  # paused; that wait was another
    made.is_slow = [SimpleNamespace(name="/bag to read /image", is_abandoned=False)]
    assert gate.is_closed
    assert gate.compute_remaining() == 5.0
    made.wall += 3.0
    assert gate.compute_remaining() == pytest.approx(2.0)
    made.is_slow.clear()
    made.flusher.on_progress()
    assert made.woken == [1, 1]
    assert not gate.is_closed
    assert gate.compute_remaining() is None
    made.wall += 60.0  # and the next wait is another
    made.is_slow = [SimpleNamespace(name="/bag", is_abandoned=False)]
    assert gate.compute_remaining() == 5.0
    assert ros.lines == []


def test_a_listener_that_takes_nothing_is_named_once_and_given_up(made, ros):
    gate = made("a")
    bag = SimpleNamespace(name="/bag to read /image", is_abandoned=False)
    made.is_slow = [bag]
    assert gate.compute_remaining() == 5.0
    made.wall += 5.0
    assert gate.compute_remaining() is None
    assert bag.is_abandoned
    assert not gate.is_closed
    assert len(ros.lines) == 1
    assert "after waiting 5 s of wall time for /bag to read /image," in ros.lines[0]
    made.is_slow = [SimpleNamespace(name="/other", is_abandoned=False)]  # which has time of its own
    assert gate.compute_remaining() == 5.0
    gate.start_round()
    made.wall += 60.0
    gate.end_round()
    assert gate.compute_remaining() == 5.0


def test_a_topic_that_nobody_publishes_is_told_so(made, ros):
    gate = made("a")
    gate.before_frame()
    made.wall += 6.0
    gate.compute_remaining()
    assert "/a (no publisher)" in ros.lines[0]


def test_rounds_may_go_by_periods_instead_of_frames(made):
    gate = made("a", period=0.01)
    gate.before_frame()
    assert not gate.is_closed
    gate.after_step(9 * MS)
    assert not gate.is_closed
    gate.after_step(10 * MS)
    assert gate.is_closed
    gate.note_message("/a")
    gate.after_step(19 * MS)
    assert not gate.is_closed
    gate.after_step(23 * MS)  # a step that goes beyond begins one round, at the multiple
    assert gate.is_closed
    gate.note_message("/a")
    gate.after_step(29 * MS)
    assert not gate.is_closed
    gate.after_step(30 * MS)
    assert gate.is_closed


def test_without_a_period_steps_begin_no_round(made):
    gate = made("a")
    for step in range(100):
        gate.after_step(step * MS)
    assert not gate.is_closed


def test_a_reset_of_time_ends_the_round_and_begins_the_periods_anew(made):
    gate = made("a", period=0.01)
    gate.after_step(500 * MS)
    gate.end_round()
    assert not gate.is_closed
    gate.after_step(10 * MS)
    assert gate.is_closed


@pytest.mark.parametrize(
    ("arguments", "remedy"),
    [
        (((), 5.0, 0.0), "lockstep_topics is empty"),
        ((("a",), 0.0, 0.0), "lockstep_timeout is 0; set a time above 0 s"),
        ((("a",), -1.0, 0.0), "lockstep_timeout is -1"),
        ((("a",), 5.0, -0.1), "lockstep_period is -0.1"),
    ],
)
def test_what_cannot_be_is_refused_with_the_remedy(ros, arguments, remedy):
    topics, timeout, period = arguments
    with pytest.raises(SimError, match=remedy):
        Lockstep(topics, timeout, lambda: None, period)


def test_who_publishes_is_asked_of_the_master(ros, monkeypatch):
    state, fault = ([["/a", ["/z", "/x"]], ["/b", ["/y"]]], [], []), []

    def answer() -> tuple:
        if fault:
            raise fault[0]
        return state

    monkeypatch.setattr(lockstep.rospy, "get_name", lambda: "/gazebo")
    monkeypatch.setattr(
        lockstep.rosgraph, "Master", lambda _name: SimpleNamespace(getSystemState=answer))
    assert ros.sender(["/a", "/c"]) == {"/a": ["/x", "/z"]}
    for error in (OSError("gone"), lockstep.rosgraph.MasterException("no")):
        fault[:] = [error]
        assert ros.sender(["/a"]) == {}
