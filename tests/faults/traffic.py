"""Faults of messages: floods, invalid values, topics of a wrong type, and plain bytes."""

from __future__ import annotations

import random
import socket
import time

import roslib.message
import rospy
from ros_graph import wait_for
from std_msgs.msg import Float64

from .arbitrary import Arbitrary
from .bed import ANSWER, COMMANDS, JOINTS, NODES, ROBOT, Bed, UnansweredError
from .outcome import Outcome

BYTES = (b"", b"\0", b"GET / HTTP/1.1\r\n\r\n", b"\xff" * 4, b"\xff\xff\xff\x7f", b"\0\0\0\0",
         b"POST / HTTP/1.1\r\nContent-Length: 99999999999\r\n\r\n", b"\x10\0\0\0callerid=/x",
         b"x" * 100_000)  # fmt: skip


def flood(bed: Bed, scale: float, seed: int) -> Outcome:
    """Send thousands of commands per second on each of six topics, as the original controllers do.
    """
    with bed.group("flood of commands") as outcome:
        publishers = [rospy.Publisher(topic, Float64, queue_size=1) for topic in COMMANDS]
        wait_for(lambda: all(p.get_num_connections() for p in publishers), 10.0, "the listeners")
        seconds, sent = max(20.0 * scale, 2.0), 0
        outcome.injected = 1
        began, clock = time.monotonic(), bed.simulated()
        while time.monotonic() - began < seconds:
            for publisher in publishers:
                publisher.publish(0.05)
            sent += len(publishers)
        factor = (bed.simulated() - clock) / (time.monotonic() - began)
        outcome.note = f"{sent / seconds:.0f} messages a second, real-time factor {factor:.3f}"
        for publisher in publishers:
            publisher.unregister()
        judged(bed, outcome, 1, "after the flood")
    return outcome


def garbage(bed: Bed, scale: float, seed: int) -> Outcome:
    """Send random messages on every topic that the nodes subscribe to, except the time."""
    draw = Arbitrary(seed, (ROBOT, *JOINTS, "J1", "base_link"))
    with bed.group("garbage on every topic") as outcome:
        each = max(round(40 * scale), 3)
        for topic, kind in bed.listened():
            publisher = rospy.Publisher(topic, kind, queue_size=each)
            wait_for(publisher.get_num_connections, 10.0, f"a listener of {topic}")
            for _ in range(each):
                try:
                    publisher.publish(draw.message(kind))
                except (rospy.ROSException, rospy.ROSSerializationException):
                    continue  # rospy itself refuses it
                outcome.injected += 1
            time.sleep(min(0.05 * each, 0.3))
            publisher.unregister()
            judged(bed, outcome, each, f"after garbage on {topic}")
        outcome.survived = min(outcome.survived, outcome.injected)
    return outcome


def wrong_types(bed: Bed, scale: float, seed: int) -> Outcome:
    """Publish with other types than those of the topics."""
    kind = roslib.message.get_message_class("std_msgs/String")
    with bed.group("topics of a wrong type") as outcome:
        for topic, expected in bed.listened():
            if expected is kind:
                continue
            outcome.injected += 1
            publisher = rospy.Publisher(topic, kind, queue_size=1)
            time.sleep(0.1)
            publisher.publish("x" * 1000)
            publisher.unregister()
        judged(bed, outcome, outcome.injected, "after publishers of a wrong type")
    return outcome


def bytes_on_ports(bed: Bed, scale: float, seed: int) -> Outcome:
    """Connections that say nonsense, or nothing and stay, on every port of every node; meanwhile
    every node answers others."""
    draw = random.Random(seed)
    with bed.group("bytes on every port") as outcome:
        silent = []
        for node in NODES:
            for port in bed.ports(node):
                for turn in range(max(round(10 * scale), 2)):
                    outcome.injected += 1
                    try:
                        connection = socket.create_connection(("127.0.0.1", port), ANSWER)
                    except TimeoutError:
                        outcome.hung.append(f"port {port} of {node} takes up no connection")
                        break
                    if turn % 2:
                        connection.sendall(draw.choice(BYTES))
                        connection.close()
                    else:
                        if turn:
                            connection.sendall(draw.choice(BYTES))
                        silent.append(connection)
            try:
                bed.call(f"{node}/get_loggers")
            except UnansweredError as error:
                outcome.hung.append(f"while connections say nothing: {error}")
        judged(bed, outcome, outcome.injected, "while connections say nothing")
        for connection in silent:
            connection.close()
        judged(bed, outcome, 0, "after bytes on every port")
    return outcome


def judged(bed: Bed, outcome: Outcome, count: int, what: str) -> None:
    """Record a batch of faults as survived if nothing is wrong after it."""
    lost = len(outcome.lost)
    bed.judge(outcome, what)
    if len(outcome.lost) == lost:
        outcome.survived += count


GROUPS = (flood, garbage, wrong_types, bytes_on_ports)
