"""A node's connections: a port that nobody can keep others from, and publishers found for good."""

from __future__ import annotations

import socket
import threading
import weakref

from rospy.impl import masterslave, tcpros_base

# Connections that may wait to be taken up. rospy lets five: of eight clients that call services all
# the time one was turned away now and then, and its kernel asks again only after a second.
BACKLOG = 128


def open_wide() -> None:
    """Take up connections to this node in threads of their own; call it after init_node.

    rospy takes one after the other, so that one which says nothing keeps all others waiting.
    Connections from this node are made by `connect_once`.
    """
    connect_once()
    tcpros_base.start_tcpros_server()
    server = tcpros_base._tcpros_server.tcp_ros_server
    take_up = server.inbound_handler

    def in_a_thread(connection: socket.socket, address: tuple[str, int]) -> None:
        threading.Thread(target=take_up, args=(connection, address), daemon=True).start()

    server.server_sock.listen(BACKLOG)
    server.inbound_handler = in_a_thread


def connect_once() -> None:
    """Connect to a publisher of a topic once, however often the master tells of it.

    rospy takes one word of the master's about a topic with two publishers for two, and tries to
    connect twice at the same time. Of two connections to one publisher it drops the first; as that
    one ends it may take the second, which has its file's number, for itself, and end it as well.
    The node then never hears of this publisher again.
    """
    connect = masterslave.ROSHandler._connect_topic
    if connect.__module__ == __name__:
        return
    locks: weakref.WeakValueDictionary[tuple[str, str], threading.Lock]
    locks = weakref.WeakValueDictionary()
    choosing = threading.Lock()

    def one_by_one(handler: masterslave.ROSHandler, topic: str, uri: str) -> tuple[int, str, int]:
        with choosing:
            lock = locks.setdefault((topic, uri), threading.Lock())
        with lock:  # whoever waited finds the connection there
            return connect(handler, topic, uri)

    masterslave.ROSHandler._connect_topic = one_by_one
