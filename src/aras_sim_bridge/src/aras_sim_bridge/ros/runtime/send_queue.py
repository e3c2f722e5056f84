"""Non-blocking queues of messages for the sockets of subscribers.

Messages that a socket does not accept at once wait in a queue. One thread for all sockets sends
them as soon as possible. If a subscriber does not read for long, the oldest messages are dropped,
as in rospy. A caller that must not lose messages (lockstep) waits while a queue `is_behind`.
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
    """Queue of messages that the socket of one connection has not accepted yet."""

    def __init__(
        self,
        connection: socket.socket,
        queue_size: int,
        on_broken: Callable[[], None],
        name: str = "",
    ) -> None:
        """Create the queue of a socket.

        Args:
            connection: socket of the subscriber.
            queue_size: largest number of waiting messages.
            on_broken: called once when the connection is broken.
            name: subscriber and topic, for log messages.
        """
        self.name = name
        self.is_abandoned = False  # lockstep does not wait for it until the queue is empty again
        self.socket = connection
        self.descriptor = connection.fileno()
        self._on_broken = on_broken
        self._lock = threading.Lock()
        self._unsent_rest: MessageParts = ()  # unsent part of a partly sent message
        self._messages: collections.deque[MessageParts] = collections.deque(maxlen=queue_size)
        self._is_broken = False

    def close(self) -> None:
        """Discard all waiting messages; the socket is closed."""
        with self._lock:
            self._is_broken = True
            self._unsent_rest = ()
            self._messages.clear()
        QUEUE_FLUSHER.forget(self)

    def send(self, parts: MessageParts) -> None:
        """Write the part of a message that the socket accepts; the rest is sent later."""
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
        """Whether a message or a part of one has not been written yet."""
        return bool(self._unsent_rest or self._messages)

    @property
    def is_behind(self) -> bool:
        """Whether a complete message is waiting and the queue is not abandoned."""
        return bool(self._messages) and not self.is_abandoned

    def flush(self) -> None:
        """Write as many of the waiting messages as the socket accepts."""
        with self._lock:
            while self.has_unsent:
                self._unsent_rest = self._write(self._unsent_rest or self._messages.popleft())
                if self._unsent_rest:
                    return
            self.is_abandoned = False

    def _write(self, parts: MessageParts) -> MessageParts:
        """Write all data that the socket accepts and return the rest.

        The rest is the object `parts` itself if nothing was written.
        """
        try:
            sent = self.socket.sendmsg(parts, (), socket.MSG_DONTWAIT)
        except (BlockingIOError, InterruptedError):
            return parts
        except OSError:  # the subscriber has disconnected
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
    """Thread that flushes the send queues; it is started on first use."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._queues: dict[int, SendQueue] = {}
        self._poll: select.epoll | None = None
        self.on_progress: Callable[[], None] = lambda: None  # called after each flush of a queue

    def list_unsent(self) -> list[SendQueue]:
        """Return the queues that have unsent data."""
        return list(self._queues.values())

    def list_behind(self) -> list[SendQueue]:
        """Return the queues in which a complete message is waiting."""
        return [queue for queue in self.list_unsent() if queue.is_behind]

    def add(self, queue: SendQueue) -> None:
        """Flush `queue` whenever its socket is writable, until the queue is empty."""
        with self._lock:
            if self._poll is None:
                self._poll = select.epoll()
                threading.Thread(target=self._run, name="queue_flusher", daemon=True).start()
            if queue.socket.fileno() < 0:  # the socket was closed in the meantime
                return
            self._queues[queue.descriptor] = queue
            with contextlib.suppress(FileExistsError):  # already registered
                self._poll.register(queue.descriptor, select.EPOLLOUT)

    def forget(self, queue: SendQueue) -> None:
        """Stop flushing `queue`."""
        with self._lock:
            # A new connection may have reused the file descriptor of a closed one.
            if self._queues.get(queue.descriptor) is not queue:
                return
            del self._queues[queue.descriptor]
            with contextlib.suppress(OSError):  # closing the socket has already unregistered it
                self._poll.unregister(queue.descriptor)

    def _run(self) -> None:
        while True:
            for descriptor, _ in self._poll.poll():
                queue = self._queues.get(descriptor)
                if queue is not None:
                    queue.flush()
                    if not queue.has_unsent:
                        self._stop_polling(queue)
                    self.on_progress()

    def _stop_polling(self, queue: SendQueue) -> None:
        """Stop polling the socket unless its queue has new data to send."""
        with self._lock:
            if not queue.has_unsent and self._queues.get(queue.descriptor) is queue:
                del self._queues[queue.descriptor]
                with contextlib.suppress(OSError):
                    self._poll.unregister(queue.descriptor)


QUEUE_FLUSHER = QueueFlusher()
