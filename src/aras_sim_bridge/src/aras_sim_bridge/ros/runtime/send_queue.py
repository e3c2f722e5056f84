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

MessageParts = Sequence[bytes | memoryview]


class SendQueue:
    """What has not been taken by one connection's socket yet."""

    def __init__(
        self,
        connection: socket.socket,
        queue_size: int,
        on_broken: Callable[[], None],
        name: str = "",
    ) -> None:
        """Write into `connection`; `on_broken` is called once when it takes no more for ever.

        name: the topic and its listener, for the log.
        """
        self.name = name
        self.is_abandoned = False  # nobody waits for it, until it has taken all
        self.socket = connection
        self.descriptor = connection.fileno()
        self._on_broken = on_broken
        self._lock = threading.Lock()
        self._unsent_rest: MessageParts = ()  # the rest of a message whose beginning was sent
        self._messages: collections.deque[MessageParts] = collections.deque(maxlen=queue_size)
        self._is_broken = False

    def close(self) -> None:
        """Forget what was not taken: the socket is closed."""
        with self._lock:
            self._is_broken = True
            self._unsent_rest = ()
            self._messages.clear()
        QUEUE_FLUSHER.forget(self)

    def send(self, parts: MessageParts) -> None:
        """Write what the socket takes now, and have the rest sent on."""
        with self._lock:
            if self._is_broken:
                return
            if self.has_unsent:
                self._messages.append(parts)
                return
            rest = self._write(parts)
            if rest is parts:
                self._messages.append(parts)
            else:
                self._unsent_rest = rest
        if rest:
            QUEUE_FLUSHER.add(self)

    @property
    def has_unsent(self) -> bool:
        """Whether something is still to be written."""
        return bool(self._unsent_rest or self._messages)

    @property
    def is_behind(self) -> bool:
        """Whether a message waits that nothing was sent of, and somebody may wait for it."""
        return bool(self._messages) and not self.is_abandoned

    def flush(self) -> None:
        """Write what the socket takes now of what is left."""
        with self._lock:
            while self.has_unsent:
                self._unsent_rest = self._write(self._unsent_rest or self._messages.popleft())
                if self._unsent_rest:
                    return
            self.is_abandoned = False

    def _write(self, parts: MessageParts) -> MessageParts:
        """Write what the socket takes; the rest, which is `parts` itself if it takes nothing."""
        try:
            sent = self.socket.sendmsg(parts, (), socket.MSG_DONTWAIT)
        except (BlockingIOError, InterruptedError):
            return parts
        except OSError:  # the listener is gone
            self._is_broken = True
            self._messages.clear()
            self._on_broken()
            return ()
        rest = []
        for part in parts:
            if sent < len(part):
                rest.append(memoryview(part)[sent:])
            sent = max(sent - len(part), 0)
        return rest


class QueueFlusher:
    """Sends on what sockets did not take at once; one thread, started when first needed."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._queues: dict[int, SendQueue] = {}
        self._poll: select.epoll | None = None
        self.on_progress: Callable[[], None] = lambda: None  # a socket took more; from this thread

    def list_unsent(self) -> list[SendQueue]:
        """Lanes that have something left."""
        return list(self._queues.values())

    def list_behind(self) -> list[SendQueue]:
        """Lanes in which a whole message waits."""
        return [lane for lane in self.list_unsent() if lane.is_behind]

    def add(self, queue: SendQueue) -> None:
        """Flush `queue` whenever its socket takes more, until nothing is left."""
        with self._lock:
            if self._poll is None:
                self._poll = select.epoll()
                threading.Thread(target=self._run, name="drain", daemon=True).start()
            if queue.socket.fileno() < 0:  # closed meanwhile
                return
            self._queues[queue.descriptor] = queue
            with contextlib.suppress(FileExistsError):  # it is waited for already
                self._poll.register(queue.descriptor, select.EPOLLOUT)

    def forget(self, queue: SendQueue) -> None:
        """Flush `queue` no more."""
        with self._lock:
            # A new connection may have got the number of a closed one meanwhile.
            if self._queues.get(queue.descriptor) is not queue:
                return
            del self._queues[queue.descriptor]
            with contextlib.suppress(OSError):  # closed, and so forgotten by the kernel
                self._poll.unregister(queue.descriptor)

    def _run(self) -> None:
        while True:
            for descriptor, _ in self._poll.poll():
                lane = self._queues.get(descriptor)
                if lane is not None:
                    lane.flush()
                    if not lane.has_unsent:
                        self._stop_polling(lane)
                    self.on_progress()

    def _stop_polling(self, queue: SendQueue) -> None:
        """Wait for the socket no more, unless the lane has something new to send."""
        with self._lock:
            if not queue.has_unsent and self._queues.get(queue.descriptor) is queue:
                del self._queues[queue.descriptor]
                with contextlib.suppress(OSError):
                    self._poll.unregister(queue.descriptor)


QUEUE_FLUSHER = QueueFlusher()
