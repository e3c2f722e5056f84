"""A node's port that nobody can keep others from."""

from __future__ import annotations

import socket
import threading

from rospy.impl import tcpros_base

# Connections that may wait to be taken up. rospy lets five: of eight clients that call services all
# the time one was turned away now and then, and its kernel asks again only after a second.
BACKLOG = 128


def open_wide() -> None:
    """Take up connections to this node in threads of their own; call it after init_node.

    rospy takes one after the other, so that one which says nothing keeps all others waiting.
    """
    tcpros_base.start_tcpros_server()
    server = tcpros_base._tcpros_server.tcp_ros_server
    take_up = server.inbound_handler

    def in_a_thread(connection: socket.socket, address: tuple[str, int]) -> None:
        threading.Thread(target=take_up, args=(connection, address), daemon=True).start()

    server.server_sock.listen(BACKLOG)
    server.inbound_handler = in_a_thread
