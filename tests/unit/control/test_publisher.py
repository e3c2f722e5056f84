"""Subscribers that come, read and leave: which messages each receives, and what is stored."""

from __future__ import annotations

import threading

import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from aras_sim_bridge.ros.runtime.publisher import NonBlockingPublisher
from aras_visual_servo_ros import send_queue


def test_who_comes_later_gets_the_last_message_of_a_latched_topic_once(ros):
    topic = NonBlockingPublisher("/t", Float64, 2, latch=True)
    topic.publish_bytes(b"one")
    topic.publish_bytes(b"two")
    first = ros.join()
    ros.tell()
    topic.publish_bytes(b"three")
    assert first.bodies(2) == [b"two", b"three"]
    second = ros.join()
    assert second.bodies(1) == [b"three"]


def test_without_latch_nothing_is_kept(ros):
    topic = NonBlockingPublisher("/t", Float64, 2)
    first = ros.join()
    topic.publish_bytes(b"one")
    second = ros.join()
    topic.publish_bytes(b"two")
    assert first.bodies(2) == [b"one", b"two"]
    assert second.bodies(1) == [b"two"]


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
