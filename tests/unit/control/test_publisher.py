"""Subscribers that come, read and leave: which messages each receives, and what is stored."""

from __future__ import annotations

import struct
import threading

import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from aras_sim_bridge.control.pid import Pid, PidGains
from aras_sim_bridge.ros.control.state_publisher import StatePublisher
from aras_sim_bridge.ros.runtime.pacing import Pacer
from aras_sim_bridge.ros.runtime.publisher import NonBlockingPublisher
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.simulation import Simulation
from aras_visual_servo_ros import send_queue


@pytest.mark.parametrize("latch", [True, False])
def test_who_comes_later_gets_the_last_message_of_a_latched_topic_once(ros, latch):
    topic = NonBlockingPublisher("/t", Float64, 2, **({"latch": True} if latch else {}))
    topic.publish_bytes(b"one")
    topic.publish_bytes(b"two")
    first = ros.join()
    ros.tell()
    topic.publish_bytes(b"three")
    second = ros.join()
    topic.publish_bytes(b"four")
    expected = [b"two"] * latch + [b"three", b"four"]
    assert first.bodies(len(expected)) == expected
    assert second.bodies(1 + latch) == expected[-1 - latch:]


@pytest.mark.parametrize("who", ["the listener", "the topic"])
def test_images_for_who_has_gone_are_let_go(ros, who):
    before = set(send_queue.QUEUE_FLUSHER.list_unsent())
    topic = NonBlockingPublisher("/t", Float64, 2)
    listener = ros.join()
    for _ in range(4):
        topic.publish_bytes(bytes(4_000_000))
    (queued,) = set(send_queue.QUEUE_FLUSHER.list_unsent()) - before
    assert queued.has_unsent
    if who == "the topic":
        topic.unregister()
    else:
        ros.leave(listener)
    assert not queued.has_unsent and topic.subscriber_count == 0
    assert queued not in send_queue.QUEUE_FLUSHER.list_unsent()


def test_changes_are_told_and_who_was_quicker_than_the_constructor_is_counted(ros):
    early = ros.make_connection()
    ros.connections = [early]
    told = []
    topic = NonBlockingPublisher("/t", Float64, 2, on_change=lambda: told.append(1))
    assert told
    assert topic.subscriber_count == 1
    before = len(told)
    ros.join()
    assert len(told) > before
    assert topic.subscriber_count == 2


def test_headers_are_numbered(ros):
    topic = NonBlockingPublisher("/t", JointState, 2)
    message = JointState()
    topic.publish(message)  # which no subscriber receives
    listener = ros.join()
    for _ in range(3):
        topic.publish(message)
    heard = [JointState().deserialize(body).header.seq for body in listener.bodies(3)]
    assert heard == [1, 2, 3]


def test_a_connection_that_is_not_up_yet_is_sent_to_once_it_is(ros):
    topic = NonBlockingPublisher("/t", Float64, 2, latch=True)
    topic.publish_bytes(b"one")
    slow = ros.make_connection()
    up, slow.socket = slow.socket, None
    ros.connections = [slow]
    ros.tell()
    topic.publish_bytes(b"two")
    slow.socket = up
    topic.publish_bytes(b"three")
    assert slow.bodies(1) == [b"three"]


def test_a_connection_that_breaks_is_taken_from_rospy_and_closed(ros):
    closed = threading.Event()
    topic = NonBlockingPublisher("/t", Float64, 2)
    listener = ros.join()
    listener.far.close()
    listener.close = closed.set
    topic.publish_bytes(b"one")
    assert closed.wait(10.0) and ros.removed == [listener]


@pytest.fixture(scope="module")
def thread():
    """A thread whose simulation is paused; a call comes after all that was posted before."""
    made = SimulationThread(Simulation, Pacer(1.0), paused=True)
    made.start()
    yield made
    made.stop()


@pytest.fixture
def advertise(ros, thread):
    """make() gives a PID, and the topic of its outputs."""

    def make():
        pid = Pid(PidGains(2.0))
        return pid, StatePublisher("/state", Float64, 1, pid, lambda message, state: setattr(
            message, "data", state.output), thread)

    return make


def is_heard(pid, thread) -> bool:
    return thread.call(lambda: pid.on_state is not None)


def test_nothing_is_built_while_nobody_listens(advertise, ros, thread):
    pid, topic = advertise()
    assert not is_heard(pid, thread)
    listener = ros.join()
    thread.call(lambda: None)
    thread.call(lambda: pid.compute(1.5, 0.1))
    assert struct.unpack("<d", *listener.bodies(1)) == (3.0,)
    topic.shutdown()
    assert not is_heard(pid, thread)


def test_a_listener_that_leaves_does_not_take_the_callback_from_a_running_update(
    advertise, ros, thread
):
    pid, _ = advertise()
    listener = ros.join()
    assert is_heard(pid, thread)

    def update():
        ros.leave(listener)  # in a thread of rospy's, between look and call
        pid.compute(1.5, 0.1)
        return pid.on_state is not None

    assert thread.call(update)
    assert not is_heard(pid, thread)


def test_who_comes_while_another_leaves_is_heard_in_whatever_order_it_is_told(
    advertise, ros, thread
):
    pid, _ = advertise()
    first = ros.join()
    tell, ros.tell = ros.tell, lambda: None
    ros.join()
    ros.leave(first)
    tell()  # both are told late
    tell()
    assert is_heard(pid, thread)


def test_a_listener_that_was_quicker_than_the_constructor_is_heard(advertise, ros, thread):
    ros.tell = lambda: None
    ros.join()
    pid, _ = advertise()
    assert is_heard(pid, thread)
