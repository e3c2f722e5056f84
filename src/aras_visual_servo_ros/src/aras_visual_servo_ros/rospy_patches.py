"""Corrections of rospy: accepting connections, reliable subscriptions, and direct publishing."""

from __future__ import annotations

import socket
import threading
import weakref
from typing import Any

import rospy
from rospy.exceptions import TransportTerminated
from rospy.impl import masterslave, registration, tcpros_base

from .send_queue import QueueFlusher, SendQueue

# Number of connections that may wait to be accepted. With rospy's value of 5, and eight clients
# that call services continuously, some connections are rejected. A rejected client tries again only
# after 1 s.
BACKLOG = 128
# Sends the messages that sockets of rospy's publishers have not accepted yet. The simulator's own
# publishers use another one, on which lockstep mode waits.
_flusher = QueueFlusher()
# Resolved names of the topics whose messages are not sent to subscribers of this node itself.
_topics_for_others: set[str] = set()


def accept_in_threads() -> None:
    """Handle each incoming connection to this node in a separate thread.

    rospy handles connections one after the other, so that a client that sends nothing blocks all
    others. Call this function after init_node.
    """
    tcpros_base.start_tcpros_server()
    server = tcpros_base._tcpros_server.tcp_ros_server
    handle = server.inbound_handler

    def handle_in_thread(connection: socket.socket, address: tuple[str, int]) -> None:
        threading.Thread(target=handle, args=(connection, address), daemon=True).start()

    server.server_sock.listen(BACKLOG)
    server.inbound_handler = handle_in_thread


def find_publishers() -> None:
    """Patch rospy so that a subscriber connects to every publisher of a topic exactly once.

    This corrects two errors of rospy. Each of them may prevent a node from receiving a publisher's
    messages at all.

    Duplicate connections: if a topic has two publishers, two threads of rospy may connect to the
    same publisher. rospy then closes one of these connections, and sometimes both.

    Lost updates: the master sends the list of a topic's publishers when a node subscribes, and
    again when a publisher starts. If both lists are pending, rospy uses only the one that arrived
    last. If they arrived in the wrong order, the new publisher is missing in it.
    """
    connect = masterslave.ROSHandler._connect_topic
    if connect.__module__ == __name__:
        return
    locks: weakref.WeakValueDictionary[tuple[str, str], threading.Lock]
    locks = weakref.WeakValueDictionary()
    locks_lock = threading.Lock()

    def connect_once(handler: masterslave.ROSHandler, topic: str, uri: str) -> tuple[int, str, int]:
        with locks_lock:
            lock = locks.setdefault((topic, uri), threading.Lock())
        # A second thread for the same topic waits here, and then finds the first thread's
        # connection.
        with lock:
            return connect(handler, topic, uri)

    update = registration.RegManager.publisher_update

    def merge_updates(manager: registration.RegManager, topic: str, uris: list[str]) -> None:
        with manager.cond:
            pending = [uri for name, known in manager.updates if name == topic for uri in known]
            update(manager, topic, list(dict.fromkeys((*pending, *uris))))

    masterslave.ROSHandler._connect_topic = connect_once
    registration.RegManager.publisher_update = merge_updates


class DirectConnection:
    """Connection of a rospy publisher to a subscriber; `publish` writes to its socket directly.

    It replaces rospy's QueuedConnection, which has a thread for each connection and wakes it for
    every message. For a node that commands six joints at 100 Hz, this takes half of its processor
    time. As in rospy, `publish` never waits for the subscriber.
    """

    def __init__(self, connection: tcpros_base.TCPROSTransport, queue_size: int) -> None:
        """Wrap a connection of rospy; at most `queue_size` messages wait, or any number if 0."""
        self._connection = connection
        self._is_broken = False
        is_own = connection.endpoint_id == rospy.get_name()
        self._is_muted = is_own and connection.name in _topics_for_others
        self._queue = SendQueue(
            connection.socket, queue_size, self._note_broken, connection.endpoint_id, _flusher
        )
        connection.set_cleanup_callback(lambda _connection: self._queue.close())

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self._connection, name)

    def write_data(self, data: bytes) -> bool:
        """Send a serialised message.

        Raises:
            TransportTerminated: the subscriber has disconnected.
        """
        if self._is_muted:
            return True
        self._queue.send((data,))
        if self._is_broken:
            raise TransportTerminated(f"{self._connection.endpoint_id} has disconnected")
        self._connection.stat_bytes += len(data)
        self._connection.stat_num_msg += 1
        return True

    def _note_broken(self) -> None:
        self._is_broken = True


def send_directly() -> None:
    """Patch rospy so that its publishers write to the sockets of their subscribers directly."""
    rospy.topics.QueuedConnection = DirectConnection


def send_to_others_only(topic: str) -> None:
    """Do not send the messages of a topic to subscribers of this node itself.

    Call this before the node subscribes to the topic. It saves the processor time of a node that
    subscribes in order to detect other publishers.
    """
    _topics_for_others.add(rospy.resolve_name(topic))
