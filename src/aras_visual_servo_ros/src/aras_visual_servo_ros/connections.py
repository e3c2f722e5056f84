"""Corrections of rospy: parallel acceptance of connections, and reliable subscriptions."""

from __future__ import annotations

import socket
import threading
import weakref

from rospy.impl import masterslave, registration, tcpros_base

# Number of connections that may wait to be accepted. With rospy's value of 5, and eight clients
# that call services continuously, some connections are rejected. A rejected client tries again only
# after 1 s.
BACKLOG = 128


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
