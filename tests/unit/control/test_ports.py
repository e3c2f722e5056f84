"""Publishing of controllers and cameras never delays the simulation."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import pytest

from aras_sim_bridge.ros.camera.compressed import BackgroundWorker
from aras_sim_bridge.ros.control import state_topic
from aras_sim_bridge.ros.control.state_topic import StateTopic


class Publisher:
    """Replacement of NonBlockingPublisher; the test adds and removes its subscribers."""

    def __init__(self, topic, message, queue_size, on_change) -> None:
        self.subscriber_count = 0
        self.on_change = on_change
        self.sent: list[object] = []
        Publisher.latest = self

    def publish(self, message: object) -> None:
        self.sent.append(message.data)

    def unregister(self) -> None:
        self.subscriber_count = 0


class Thread:
    """Replacement of SimulationThread, whose jobs the test runs."""

    def __init__(self) -> None:
        self.jobs = []

    def post(self, job) -> None:
        self.jobs.append(job)

    def turn(self) -> None:
        jobs, self.jobs = self.jobs, []
        for job in jobs:
            job()


@pytest.fixture
def topic(monkeypatch):
    """A state topic of `port`, with its thread and its publisher."""
    monkeypatch.setattr(state_topic, "NonBlockingPublisher", Publisher)
    port, thread = SimpleNamespace(on_state=None), Thread()
    made = StateTopic(
        "/state", lambda: SimpleNamespace(data=None), 1, port,
        lambda message, state: setattr(message, "data", state), thread,
    )  # fmt: skip
    return SimpleNamespace(topic=made, port=port, thread=thread, publisher=Publisher.latest)


def listen(topic, count: int) -> None:
    topic.publisher.subscriber_count = count
    topic.publisher.on_change()


def test_nothing_is_built_while_nobody_listens(topic):
    topic.thread.turn()
    assert topic.port.on_state is None
    listen(topic, 1)
    topic.thread.turn()
    topic.port.on_state(3)
    assert topic.publisher.sent == [3]


def test_a_listener_that_leaves_does_not_take_the_callback_from_a_running_update(topic):
    listen(topic, 1)
    topic.thread.turn()
    assert topic.port.on_state is not None  # an update has looked
    listen(topic, 0)  # in a thread of rospy's, between look and call
    topic.port.on_state(4)
    topic.thread.turn()
    assert topic.port.on_state is None


def test_who_comes_while_another_leaves_is_heard_in_whatever_order_it_is_told(topic):
    listen(topic, 1)
    topic.publisher.subscriber_count = 2  # one comes,
    topic.publisher.subscriber_count = 1  # the other leaves,
    topic.publisher.on_change()  # and both are told late
    topic.publisher.on_change()
    topic.thread.turn()
    assert topic.port.on_state is not None


def test_a_listener_that_was_quicker_than_the_constructor_is_heard(monkeypatch):
    class Awaited(Publisher):
        def __init__(self, *args, **options) -> None:
            super().__init__(*args, **options)
            self.subscriber_count = 1  # rospy told nobody

    monkeypatch.setattr(state_topic, "NonBlockingPublisher", Awaited)
    port, thread = SimpleNamespace(on_state=None), Thread()
    StateTopic("/state", SimpleNamespace, 1, port, lambda message, state: None, thread)
    thread.turn()
    assert port.on_state is not None


def test_a_topic_that_is_shut_down_is_silent(topic):
    listen(topic, 1)
    topic.thread.turn()
    topic.topic.shutdown()
    topic.thread.turn()
    assert topic.port.on_state is None


def test_nobody_waits_for_the_encoder_and_the_newest_frames_stay():
    begun, go, done = threading.Event(), threading.Event(), threading.Event()
    worked = []

    def work(item: int) -> None:
        begun.set()
        assert go.wait(10.0)
        worked.append(item)
        if item == 99:
            done.set()

    encoder = BackgroundWorker(work, 4, "encoder")
    encoder.put(0)
    assert begun.wait(10.0)
    for n in range(1, 100):
        encoder.put(n)  # comes back at once, or this test never ends
    go.set()
    assert done.wait(10.0)
    encoder.stop()
    assert worked == [0, 96, 97, 98, 99]


def test_an_encoder_that_is_stopped_lets_the_rest_be():
    worked = []
    stopped = threading.Event()

    def work(item: int) -> None:
        worked.append(item)
        encoder.stop()
        stopped.set()

    encoder = BackgroundWorker(work, 4, "to be stopped")
    encoder.put(1)
    encoder.put(2)
    assert stopped.wait(10.0)
    ended = [t for t in threading.enumerate() if t.name == "to be stopped"]
    for thread in ended:
        thread.join(10.0)
        assert not thread.is_alive()
    assert worked == [1]
