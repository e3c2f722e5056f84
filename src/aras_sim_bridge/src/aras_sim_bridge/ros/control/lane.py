"""Writes messages into a socket without ever waiting.

What does not fit is sent on by one thread for all sockets, as soon as they take more; of a
listener that does not read for long the oldest messages are dropped, as from rospy's queue.
"""

from __future__ import annotations

import collections
import contextlib
import select
import socket
import threading
from collections.abc import Callable, Sequence
from typing import Any

Parts = Sequence[bytes | memoryview]


class Lane:
    """What has not been taken by one connection's socket yet."""

    def __init__(
        self, connection: Any, queue_size: int, on_lost: Callable[[Any], None]
    ) -> None:
        self.socket = connection.socket
        self._connection = connection
        self._on_lost = on_lost
        self._lock = threading.Lock()
        self._begun: Parts = ()  # the rest of a message whose beginning was sent
        self._waiting: collections.deque[Parts] = collections.deque(maxlen=queue_size)
        self._lost = False

    def send(self, parts: Parts) -> None:
        """Write what the socket takes now, and have the rest sent on."""
        with self._lock:
            if self._lost:
                return
            if self.left:
                self._waiting.append(parts)
                return
            rest = self._write(parts)
            if rest is parts:
                self._waiting.append(parts)
            else:
                self._begun = rest
        if rest:
            _drain.add(self)

    @property
    def left(self) -> bool:
        """Whether something is still to be written."""
        return bool(self._begun or self._waiting)

    def flush(self) -> None:
        """Write what the socket takes now of what is left."""
        with self._lock:
            while self.left:
                self._begun = self._write(self._begun or self._waiting.popleft())
                if self._begun:
                    return

    def _write(self, parts: Parts) -> Parts:
        """Write what the socket takes; the rest, which is `parts` itself if it takes nothing."""
        try:
            sent = self.socket.sendmsg(parts, (), socket.MSG_DONTWAIT)
        except (BlockingIOError, InterruptedError):
            return parts
        except OSError:  # the listener is gone
            self._lost = True
            self._waiting.clear()
            self._on_lost(self._connection)
            return ()
        rest = []
        for part in parts:
            if sent < len(part):
                rest.append(memoryview(part)[sent:])
            sent = max(sent - len(part), 0)
        return rest


class _Drain:
    """Sends on what sockets did not take at once; one thread, started when first needed."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._lanes: dict[int, Lane] = {}
        self._poll: select.epoll | None = None

    def add(self, lane: Lane) -> None:
        """Flush `lane` whenever its socket takes more, until nothing is left."""
        with self._lock:
            if self._poll is None:
                self._poll = select.epoll()
                threading.Thread(target=self._run, name="drain", daemon=True).start()
            descriptor = lane.socket.fileno()
            if descriptor < 0:  # closed meanwhile
                return
            self._lanes[descriptor] = lane
            try:
                self._poll.register(descriptor, select.EPOLLOUT)
            except FileExistsError:
                self._poll.modify(descriptor, select.EPOLLOUT)

    def _run(self) -> None:
        while True:
            for descriptor, _ in self._poll.poll():
                lane = self._lanes[descriptor]
                lane.flush()
                with self._lock:
                    # A new connection may have got the number of a closed one meanwhile, and
                    # the lane something new to send.
                    if self._lanes[descriptor] is not lane or lane.left:
                        continue
                    del self._lanes[descriptor]
                    with contextlib.suppress(OSError):  # closed, and so forgotten
                        self._poll.unregister(descriptor)


_drain = _Drain()
