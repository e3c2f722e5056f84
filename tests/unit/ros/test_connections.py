"""A node's port serves everybody, whatever another connection does."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator

import pytest
from rospy.impl import tcpros_base

from aras_visual_servo_ros import connections

GREATEST_BACKLOG = struct.Struct("28x I")  # of a listening socket, in Linux's tcp_info


@pytest.fixture
def port(monkeypatch) -> Iterator[int]:
    """A port as a node of rospy has it, which answers services by their names."""
    monkeypatch.setattr(tcpros_base, "_tcpros_server", None)
    connections.open_wide()
    server = tcpros_base._tcpros_server

    def answer(connection: socket.socket, _address: object, header: dict[str, str]) -> None:
        connection.sendall(header["service"].encode())

    server.service_connection_handler = answer
    yield server.tcp_ros_server.port
    server.shutdown()


def test_one_that_says_nothing_keeps_nobody_waiting(port):
    silent = [socket.create_connection(("127.0.0.1", port)) for _ in range(3)]
    with socket.create_connection(("127.0.0.1", port), timeout=20.0) as asks:
        field = b"service=/x"
        asks.sendall(struct.pack("<II", len(field) + 4, len(field)) + field)
        assert asks.recv(100) == b"/x"
    for connection in silent:
        connection.close()


def test_many_may_come_at_once(port):
    listening = tcpros_base._tcpros_server.tcp_ros_server.server_sock
    info = listening.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, GREATEST_BACKLOG.size)
    assert GREATEST_BACKLOG.unpack(info) == (connections.BACKLOG,)
