"""Writes messages into a socket without ever waiting.

What does not fit is sent on by one thread for all sockets, as soon as they take more; of a
listener that does not read for long the oldest messages are dropped, as from rospy's queue. Who
must not lose one (lockstep) asks who is `behind` before the next message, and waits.
"""

from __future__ import annotations

import collections
import contextlib
import select
import socket
import threading
from collections.abc import Callable, Sequence

Parts = Sequence[bytes | memoryview]


class Lane:
    """What has not been taken by one connection's socket yet."""

    def __init__(
        self, target: socket.socket, queue_size: int, on_lost: Callable[[], None], name: str = ""
    ) -> None:
        """Write into `target`; `on_lost` is called once when it takes no more for ever.

        name: the topic and its listener, for the log.
        """
        self.name = name
        self.given_up = False  # nobody waits for it, until it has taken all
        self.socket = target
        self.descriptor = target.fileno()
        self._on_lost = on_lost
        self._lock = threading.Lock()
        self._begun: Parts = ()  # the rest of a message whose beginning was sent
        self._waiting: collections.deque[Parts] = collections.deque(maxlen=queue_size)
        self._lost = False

    def close(self) -> None:
        """Forget what was not taken: the socket is closed."""
        with self._lock:
            self._lost = True
            self._begun = ()
            self._waiting.clear()
        DRAIN.forget(self)

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
            DRAIN.add(self)

    @property
    def left(self) -> bool:
        """Whether something is still to be written."""
        return bool(self._begun or self._waiting)

    @property
    def behind(self) -> bool:
        """Whether a message waits that nothing was sent of, and somebody may wait for it."""
        return bool(self._waiting) and not self.given_up

    def flush(self) -> None:
        """Write what the socket takes now of what is left."""
        with self._lock:
            while self.left:
                self._begun = self._write(self._begun or self._waiting.popleft())
                if self._begun:
                    return
            self.given_up = False

    def _write(self, parts: Parts) -> Parts:
        """Write what the socket takes; the rest, which is `parts` itself if it takes nothing."""
        try:
            sent = self.socket.sendmsg(parts, (), socket.MSG_DONTWAIT)
        except (BlockingIOError, InterruptedError):
            return parts
        except OSError:  # the listener is gone
            self._lost = True
            self._waiting.clear()
            self._on_lost()
            return ()
        rest = []
        for part in parts:
            if sent < len(part):
                rest.append(memoryview(part)[sent:])
            sent = max(sent - len(part), 0)
        return rest


class Drain:
    """Sends on what sockets did not take at once; one thread, started when first needed."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._lanes: dict[int, Lane] = {}
        self._poll: select.epoll | None = None
        self.on_taken: Callable[[], None] = lambda: None  # a socket took more; from this thread

    def sending(self) -> list[Lane]:
        """Lanes that have something left."""
        return list(self._lanes.values())

    def behind(self) -> list[Lane]:
        """Lanes in which a whole message waits."""
        return [lane for lane in self.sending() if lane.behind]

    def add(self, lane: Lane) -> None:
        """Flush `lane` whenever its socket takes more, until nothing is left."""
        with self._lock:
            if self._poll is None:
                self._poll = select.epoll()
                threading.Thread(target=self._run, name="drain", daemon=True).start()
            if lane.socket.fileno() < 0:  # closed meanwhile
                return
            self._lanes[lane.descriptor] = lane
            with contextlib.suppress(FileExistsError):  # it is waited for already
                self._poll.register(lane.descriptor, select.EPOLLOUT)

    def forget(self, lane: Lane) -> None:
        """Flush `lane` no more."""
        with self._lock:
            # A new connection may have got the number of a closed one meanwhile.
            if self._lanes.get(lane.descriptor) is not lane:
                return
            del self._lanes[lane.descriptor]
            with contextlib.suppress(OSError):  # closed, and so forgotten by the kernel
                self._poll.unregister(lane.descriptor)

    def _run(self) -> None:
        while True:
            for descriptor, _ in self._poll.poll():
                lane = self._lanes.get(descriptor)
                if lane is not None:
                    lane.flush()
                    if not lane.left:
                        self._rest(lane)
                    self.on_taken()

    def _rest(self, lane: Lane) -> None:
        """Wait for the socket no more, unless the lane has something new to send."""
        with self._lock:
            if not lane.left and self._lanes.get(lane.descriptor) is lane:
                del self._lanes[lane.descriptor]
                with contextlib.suppress(OSError):
                    self._poll.unregister(lane.descriptor)


DRAIN = Drain()
