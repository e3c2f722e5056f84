"""A node serves all connections, independently of each other."""

import socket
import struct
import threading
import time
from collections.abc import Iterator
from types import SimpleNamespace

import pytest
from rospy.impl import masterslave, registration, tcpros_base

from aras_visual_servo_ros import rospy_patches as connections

CONNECT = masterslave.ROSHandler._connect_topic  # as rospy has it
UPDATE = registration.RegManager.publisher_update
GREATEST_BACKLOG = struct.Struct("28x I")  # of a listening socket, in Linux's tcp_info


@pytest.fixture
def port(monkeypatch) -> Iterator[int]:
    """A port as a node of rospy has it, which answers services by their names."""
    monkeypatch.setattr(tcpros_base, "_tcpros_server", None)
    monkeypatch.setattr(masterslave.ROSHandler, "_connect_topic", CONNECT)
    monkeypatch.setattr(registration.RegManager, "publisher_update", UPDATE)
    connections.find_publishers()
    connections.accept_in_threads()
    server = tcpros_base._tcpros_server

    def answer(connection: socket.socket, _address: object, header: dict[str, str]) -> None:
        connection.sendall(header["service"].encode())

    server.service_connection_handler = answer
    yield server.tcp_ros_server.port
    server.shutdown()


def test_silent_connections_keep_nobody_waiting_and_many_may_come_at_once(port):
    silent = [socket.create_connection(("127.0.0.1", port)) for _ in range(3)]
    with socket.create_connection(("127.0.0.1", port), timeout=20.0) as asks:
        field = b"service=/x"
        asks.sendall(struct.pack("<II", len(field) + 4, len(field)) + field)
        assert asks.recv(100) == b"/x"
    for connection in silent:
        connection.close()
    listening = tcpros_base._tcpros_server.tcp_ros_server.server_sock
    info = listening.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, GREATEST_BACKLOG.size)
    assert GREATEST_BACKLOG.unpack(info) == (connections.BACKLOG,)
    mended = masterslave.ROSHandler._connect_topic, registration.RegManager.publisher_update
    connections.find_publishers()
    assert (masterslave.ROSHandler._connect_topic,
            registration.RegManager.publisher_update) == mended  # fmt: skip
    assert not {*mended} & {CONNECT, UPDATE}


class Publishers:
    """Publishers that answer when `asked` is set, and the node that connects to them."""

    def __init__(self, monkeypatch) -> None:
        self.connected: list[tuple[str, str]] = []
        self.asked: list[str] = []
        self.answer = threading.Event()
        self.handler = masterslave.ROSHandler.__new__(masterslave.ROSHandler)
        self.handler.protocol_handlers = [SimpleNamespace(
            get_supported=lambda: [["TCPROS"]], supports=lambda protocol: protocol == "TCPROS",
            create_transport=self.connect)]
        manager = SimpleNamespace(get_subscriber_impl=lambda topic: SimpleNamespace(
            has_connection=lambda uri: (topic, uri) in self.connected))  # fmt: skip
        monkeypatch.setattr(masterslave, "get_topic_manager", lambda: manager)
        # or every socket of the tests after these would wait for a minute
        monkeypatch.setattr(masterslave.socket, "setdefaulttimeout", lambda _: None)
        monkeypatch.setattr(masterslave, "xmlrpcapi", lambda uri, cache: SimpleNamespace(
            requestTopic=lambda *_: self.request(uri)))  # fmt: skip

    def connect(self, topic: str, uri: str, _protocol: object) -> tuple[int, str, int]:
        self.connected.append((topic, uri))
        return 1, "", 0

    def request(self, uri: str) -> tuple[int, str, list]:
        self.asked.append(uri)
        if uri == "slow":
            assert self.answer.wait(20.0)
        return 1, "", ["TCPROS", "127.0.0.1", 1]

    def told(self, topic: str, uri: str) -> threading.Thread:
        thread = threading.Thread(target=self.handler._connect_topic, args=(topic, uri),
                                  daemon=True)
        thread.start()
        return thread


@pytest.fixture
def publishers(port, monkeypatch) -> Publishers:
    return Publishers(monkeypatch)


def test_a_publisher_that_the_master_tells_of_twice_is_connected_to_once_a_topic(publishers):
    threads = [publishers.told(topic, "slow") for topic in ("/x", "/x", "/y", "/y")]
    for other in (("/x", "quick"), ("/y", "quick")):  # do not wait for it
        publishers.told(*other).join(20.0)
        assert publishers.connected[-1] == other
    deadline = time.monotonic() + 20.0
    while publishers.asked.count("slow") < 2 and time.monotonic() < deadline:
        time.sleep(0.01)  # neither topic waits for the other
    assert publishers.asked.count("slow") == 2
    publishers.answer.set()
    for thread in threads:
        thread.join(20.0)
    assert sorted(publishers.connected[2:]) == [("/x", "slow"), ("/y", "slow")]
    assert publishers.asked.count("slow") == 2


def test_a_publisher_that_has_come_back_is_connected_to_again(publishers):
    for _ in range(2):
        publishers.told("/x", "quick").join(20.0)
        assert publishers.connected == [("/x", "quick")]
        publishers.connected.clear()
    assert publishers.asked == ["quick", "quick"]


def test_what_the_master_told_outlives_the_older_answer_to_the_subscription(port):
    """Four words at once, and one that comes later."""
    connected = []
    manager = registration.RegManager.__new__(registration.RegManager)
    manager.cond, manager.updates = threading.Condition(), []
    manager.handler = SimpleNamespace(done=False, _connect_topic=lambda *what: (
        connected.append(what), (1, "", 0))[1])  # fmt: skip
    for topic, uris in (("/x", ["a"]), ("/y", ["c"]), ("/x", ["a", "b"]), ("/x", [])):
        manager.publisher_update(topic, uris)
    connecting = threading.Thread(target=manager.run)
    connecting.start()
    try:
        expected = [("/x", "a"), ("/x", "b"), ("/y", "c")]
        deadline = time.monotonic() + 20.0
        while len(connected) < 3 and time.monotonic() < deadline:
            time.sleep(0.01)
        assert sorted(connected) == expected
        manager.publisher_update("/x", ["d"])  # what has been told is not told again
        while len(connected) < 4 and time.monotonic() < deadline:
            time.sleep(0.01)
        assert connected[3:] == [("/x", "d")]
    finally:
        manager.handler.done = True
        connecting.join(20.0)
