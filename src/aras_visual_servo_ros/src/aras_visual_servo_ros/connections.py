"""A node's connections: a port that nobody can keep others from, and publishers found for good."""

from __future__ import annotations

import socket
import threading
import weakref

from rospy.impl import masterslave, registration, tcpros_base

# Connections that may wait to be taken up. rospy lets five: of eight clients that call services all
# the time one was turned away now and then, and its kernel asks again only after a second.
BACKLOG = 128


def accept_in_threads() -> None:
    """Take up connections to this node in threads of their own; call it after init_node.

    rospy takes one after the other, so that one which says nothing keeps all others waiting.
    """
    tcpros_base.start_tcpros_server()
    server = tcpros_base._tcpros_server.tcp_ros_server
    take_up = server.inbound_handler

    def handle_in_thread(connection: socket.socket, address: tuple[str, int]) -> None:
        threading.Thread(target=take_up, args=(connection, address), daemon=True).start()

    server.server_sock.listen(BACKLOG)
    server.inbound_handler = handle_in_thread


def find_publishers() -> None:
    """Let this process connect to every publisher of a topic once, whenever the master tells of it.

    rospy takes one word of the master's about a topic with two publishers for two, and tries to
    connect twice at the same time. Of two connections to one publisher it drops the first; as that
    one ends it may take the second, which has its file's number, for itself, and end it as well.

    Of two words about a topic, rospy drops the one that came to it first. Where a publisher begins
    just after this node has subscribed, that is the word about it, as the answer to the
    subscription may come in after it. In either case the node never hears of this publisher again.
    """
    connect = masterslave.ROSHandler._connect_topic
    if connect.__module__ == __name__:
        return
    locks: weakref.WeakValueDictionary[tuple[str, str], threading.Lock]
    locks = weakref.WeakValueDictionary()
    choosing = threading.Lock()

    def connect_once(handler: masterslave.ROSHandler, topic: str, uri: str) -> tuple[int, str, int]:
        with choosing:
            lock = locks.setdefault((topic, uri), threading.Lock())
        with lock:  # whoever waited finds the connection there
            return connect(handler, topic, uri)

    update = registration.RegManager.publisher_update

    def merge_updates(manager: registration.RegManager, topic: str, uris: list[str]) -> None:
        with manager.cond:
            before = [uri for name, given in manager.updates if name == topic for uri in given]
            update(manager, topic, list(dict.fromkeys((*before, *uris))))

    masterslave.ROSHandler._connect_topic = connect_once
    registration.RegManager.publisher_update = merge_updates
