"""Waiting for a condition, and reading what a listener's socket has received."""

import time
from collections.abc import Callable


def until(condition: Callable[[], object]) -> object:
    """Return the first true value of a condition."""
    end = time.monotonic() + 30.0
    while not (found := condition()):
        assert time.monotonic() < end
        time.sleep(0.002)
    return found


def messages(connection: object, kind: type) -> list:
    """Return the messages in a listener's socket, which may be none."""
    data, found = b"", []
    try:
        while True:
            data += connection.heard.recv(1 << 20)
    except BlockingIOError:
        pass
    while data:
        size = int.from_bytes(data[:4], "little")
        found.append(kind().deserialize(data[4 : 4 + size]))
        data = data[4 + size :]
    return found
