"""Receiver of command messages, which the simulation thread reads itself between two steps.

The thread reads the sockets of command topics just before a step, without blocking. A message that
arrives before a step therefore takes effect in this step. At high message rates, all but the newest
messages are skipped without being decoded. All other requests wake the thread through an event.
"""

from __future__ import annotations

import collections
import contextlib
import os
import select
import socket
import struct
from collections.abc import Callable, Iterable

BUFFER_SIZE = 1 << 20  # largest number of bytes per read from a socket
# Largest length of a message, bytes. A larger length field means that the data are corrupt.
LARGEST_MESSAGE = 1 << 24
_LENGTH = struct.Struct("<I")


class MessageStream:
    """Messages of one TCPROS connection. A message is sent as its length (4 bytes) and its body."""

    def __init__(
        self,
        source: socket.socket,
        on_message: Callable[[bytes], None],
        on_end: Callable[[], None],
        bodies: Iterable[bytes] = (),
        remainder: bytes = b"",
    ) -> None:
        """Continue to read the socket `source`.

        Args:
            source: socket of the connection.
            on_message: function that is called with the body of each message that is not skipped.
            on_end: function that is called when the connection has ended.
            bodies: bodies of the messages that have already been read from `source`.
            remainder: bytes of an incomplete message that have already been read.
        """
        self.descriptor = source.fileno()
        self._source = source
        self._on_message = on_message
        self.on_end = on_end
        self._remainder = remainder
        self._bodies = collections.deque(bodies)
        self._delivered_ns = -1
        # number of messages that were skipped because newer ones had arrived
        self.skipped_count = 0

    def read(self, buffer: bytearray) -> bool:
        """Read all available bytes from the socket; return False if the connection has ended.

        `buffer` is only used during the call.
        """
        try:
            count = self._source.recv_into(buffer, 0, socket.MSG_DONTWAIT)
        except (BlockingIOError, InterruptedError):
            return True
        except OSError:
            return False
        return count > 0 and self._split(self._remainder + buffer[:count])

    def _split(self, data: bytes) -> bool:
        start, end = 0, len(data)
        while end - start >= _LENGTH.size:
            (size,) = _LENGTH.unpack_from(data, start)
            if size > LARGEST_MESSAGE:
                return False
            body = start + _LENGTH.size
            if end - body < size:
                break
            start = body + size
            self._bodies.append(data[body:start])
        self._remainder = data[start:]
        return True

    def deliver(self, time_ns: int, backlog: int) -> bool:
        """Pass the oldest message that has not been skipped to `on_message`.

        First, all messages except the newest `backlog` + 1 are skipped. If `backlog` is positive,
        only one message is passed on per step; the others wait for later steps.

        Args:
            time_ns: simulated time at the start of the next step, ns.
            backlog: largest number of messages that wait afterwards.

        Returns:
            Whether a message was passed on.
        """
        bodies = self._bodies
        if not bodies or (backlog and self._delivered_ns == time_ns):
            return False
        while len(bodies) > backlog + 1:
            bodies.popleft()
            self.skipped_count += 1
        self._delivered_ns = time_ns
        self._on_message(bodies.popleft())
        return True


class MessageReceiver:
    """Wake-up event and command messages of the simulation thread.

    Any thread may call `wake`; all other methods may only be called in the simulation thread.
    """

    def __init__(self) -> None:
        self._wake_event = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._poll = select.epoll()
        self._streams: dict[int, MessageStream] = {}
        self._buffer = bytearray(BUFFER_SIZE)

    def wake(self) -> None:
        """Wake the simulation thread so that it checks for work; may be called from any thread."""
        with contextlib.suppress(OSError):  # if the thread has ended, the event is closed
            os.eventfd_write(self._wake_event, 1)

    def clear_wake(self) -> None:
        """Clear the wake-up event. Call this before checking for work, so that no event is lost."""
        with contextlib.suppress(BlockingIOError):
            os.eventfd_read(self._wake_event)

    def wait(self, seconds: float | None, commands: bool = True) -> bool:
        """Wait for a wake-up event, a command, or the timeout; return whether a command arrived.

        `seconds` is the timeout, s of wall time; None means no timeout. Commands end the wait only
        if `commands` is True.
        """
        sources = (
            [self._wake_event, self._poll] if commands and self._streams else [self._wake_event]
        )
        ready, _, _ = select.select(sources, [], [], seconds)
        return self._poll in ready

    def add(self, stream: MessageStream) -> None:
        """Start to read `stream`."""
        # An earlier stream with the same file descriptor has ended: the system reuses the number of
        # a closed socket.
        self._end(self._streams.pop(stream.descriptor, None))
        try:
            self._poll.register(stream.descriptor, select.EPOLLIN)
        except (OSError, ValueError):  # the stream's socket was closed in the meantime
            self._end(stream)
            return
        self._streams[stream.descriptor] = stream

    def remove(self, stream: MessageStream) -> None:
        """Stop reading `stream`."""
        if self._streams.get(stream.descriptor) is stream:
            del self._streams[stream.descriptor]
            with contextlib.suppress(OSError, ValueError):
                self._poll.unregister(stream.descriptor)
        self._end(stream)

    def deliver(self, time_ns: int, backlog: int) -> bool:
        """Read all streams and pass on the commands for the step that starts at `time_ns`.

        Return whether there was a command. Of each stream, at most `backlog` commands wait for
        later steps; older ones are skipped.
        """
        if not self._streams:
            return False
        delivered = False
        for descriptor, _ in self._poll.poll(0):
            stream = self._streams[descriptor]
            if not stream.read(self._buffer):
                # The connection has ended: deliver its last message.
                delivered = stream.deliver(time_ns, 0) or delivered
                self.remove(stream)
        for stream in self._streams.values():
            delivered = stream.deliver(time_ns, backlog) or delivered
        return delivered

    def take_skipped_count(self) -> int:
        """Return how many messages were skipped in the stream that skipped the most.

        Messages count since the last call of this method.
        """
        most = 0
        for stream in self._streams.values():
            most, stream.skipped_count = max(most, stream.skipped_count), 0
        return most

    def close(self) -> None:
        """Stop reading all streams."""
        for stream in list(self._streams.values()):
            self.remove(stream)

    @staticmethod
    def _end(stream: MessageStream | None) -> None:
        if stream is not None:
            stream.on_end()
