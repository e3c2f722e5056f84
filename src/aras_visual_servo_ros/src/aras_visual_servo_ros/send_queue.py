"""Queues of messages for the sockets of subscribers; sending does not block.

A message that a socket does not accept immediately waits in a queue. One thread for all sockets
sends the waiting messages as soon as possible. If a subscriber does not read for a long time, the
oldest messages are dropped, as in rospy. To lose no message, the simulator's lockstep mode stops
simulated time while `is_behind` is True for one of its queues.
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
        flusher: QueueFlusher | None = None,
    ) -> None:
        """Create the queue of a socket.

        Args:
            connection: socket of the subscriber.
            queue_size: largest number of waiting messages; 0 for any number.
            on_broken: function that is called once when the connection is broken.
            name: name of the subscriber and the topic in log messages.
            flusher: object that sends the waiting messages; None for QUEUE_FLUSHER.
        """
        self.name = name
        # Set to True by lockstep mode when it no longer waits for this queue, and to False by
        # `flush` when the queue is empty.
        self.is_abandoned = False
        self.socket = connection
        self.descriptor = connection.fileno()
        self._on_broken = on_broken
        self._flusher = flusher or QUEUE_FLUSHER
        self._lock = threading.Lock()
        self._unsent_rest: MessageParts = ()
        self._messages: collections.deque[MessageParts] = collections.deque(
            maxlen=queue_size or None
        )
        self._is_broken = False

    def close(self) -> None:
        """Discard all waiting messages, because the socket is closed."""
        with self._lock:
            self._is_broken = True
            self._unsent_rest = ()
            self._messages.clear()
        self._flusher.forget(self)

    def send(self, parts: MessageParts) -> None:
        """Write as much of a message as the socket accepts; the rest is sent later."""
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
            self._flusher.add(self)

    @property
    def has_unsent(self) -> bool:
        """Whether a message has not been written completely."""
        return bool(self._unsent_rest or self._messages)

    @property
    def is_behind(self) -> bool:
        """Whether lockstep mode must wait, because a complete message has not been sent.

        This is False while `is_abandoned` is True.
        """
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

        If nothing is written, the result is the object `parts` itself.
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
        # Function that is called each time data of a queue have been sent.
        self.on_progress: Callable[[], None] = lambda: None

    def list_unsent(self) -> list[SendQueue]:
        """Return the queues that have unsent data."""
        return list(self._queues.values())

    def list_behind(self) -> list[SendQueue]:
        """Return the queues for which `is_behind` is True."""
        return [queue for queue in self.list_unsent() if queue.is_behind]

    def add(self, queue: SendQueue) -> None:
        """Send the messages of `queue` when its socket is writable, until the queue is empty."""
        with self._lock:
            if self._poll is None:
                self._poll = select.epoll()
                threading.Thread(target=self._run, name="queue_flusher", daemon=True).start()
            if queue.socket.fileno() < 0:  # the queue's socket was closed in the meantime
                return
            self._queues[queue.descriptor] = queue
            with contextlib.suppress(FileExistsError):  # the queue is already registered
                self._poll.register(queue.descriptor, select.EPOLLOUT)

    def forget(self, queue: SendQueue) -> None:
        """Stop sending the messages of `queue`."""
        with self._lock:
            # The file descriptor of the queue's closed connection may now belong to the queue of a
            # new connection.
            if self._queues.get(queue.descriptor) is not queue:
                return
            del self._queues[queue.descriptor]
            # A closed socket is no longer registered.
            with contextlib.suppress(OSError):
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
        """Stop watching whether the socket is writable, unless its queue has new data to send."""
        with self._lock:
            if not queue.has_unsent and self._queues.get(queue.descriptor) is queue:
                del self._queues[queue.descriptor]
                with contextlib.suppress(OSError):
                    self._poll.unregister(queue.descriptor)


QUEUE_FLUSHER = QueueFlusher()
