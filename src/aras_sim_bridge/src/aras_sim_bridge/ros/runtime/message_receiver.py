"""What comes to the simulation's thread from outside, and is taken in between two steps.

Commands come in streams: the thread itself reads their sockets just before a step, never waiting.
What arrived before a step is known in it, and a flood costs one read a step, in which all but the
last messages are passed over undecoded. Everything else rings the bell.
"""

from __future__ import annotations

import collections
import contextlib
import os
import select
import socket
import struct
from collections.abc import Callable, Iterable

BUFFER_SIZE = 1 << 20  # bytes taken from a socket in one go
LARGEST_MESSAGE = 1 << 24  # bytes of one message: a length beyond it is no length
_LENGTH = struct.Struct("<I")


class MessageStream:
    """Messages of one connection, as TCPROS sends them: length (4 bytes, little-endian), body."""

    def __init__(
        self,
        source: socket.socket,
        on_message: Callable[[bytes], None],
        on_end: Callable[[], None],
        bodies: Iterable[bytes] = (),
        remainder: bytes = b"",
    ) -> None:
        """Read `source` from here on.

        Args:
            take: gets the body of each message that acts.
            ended: called when there will be no more.
            bodies: of messages that have been read from `source` already.
            rest: what has been read after them.
        """
        self.descriptor = source.fileno()
        self._source = source
        self._on_message = on_message
        self.on_end = on_end
        self._remainder = remainder
        self._bodies = collections.deque(bodies)
        self._delivered_ns = -1
        self.skipped_count = 0  # messages that never act: newer ones had come before their step

    def read(self, buffer: bytearray) -> bool:
        """Take in what the socket holds, by way of `buffer`; False: the connection has ended."""
        try:
            count = self._source.recv_into(buffer, 0, socket.MSG_DONTWAIT)
        except (BlockingIOError, InterruptedError):
            return True
        except OSError:
            return False
        return count > 0 and self._split(self._remainder + buffer[:count])

    def _split(self, data: bytes) -> bool:
        begin, end = 0, len(data)
        while end - begin >= _LENGTH.size:
            (size,) = _LENGTH.unpack_from(data, begin)
            if size > LARGEST_MESSAGE:
                return False
            body = begin + _LENGTH.size
            if end - body < size:
                break
            begin = body + size
            self._bodies.append(data[body:begin])
        self._remainder = data[begin:]
        return True

    def deliver(self, time_ns: int, backlog: int) -> bool:
        """Hand on the message that is to act in the step from `time_ns`; whether there was one.

        Messages act in their order, one a step. Of those that wait then the newest `backlog` are
        kept for the next steps; with none, the newest acts at once, whatever acted before.
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
    """The bell, which anybody may ring, and the streams, which are the simulation's thread's."""

    def __init__(self) -> None:
        self._wake_event = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._poll = select.epoll()
        self._streams: dict[int, MessageStream] = {}
        self._buffer = bytearray(BUFFER_SIZE)

    def wake(self) -> None:
        """Let the thread look again whether there is something to do; from any thread."""
        with contextlib.suppress(OSError):  # closed: nobody looks any more
            os.eventfd_write(self._wake_event, 1)

    def clear_wake(self) -> None:
        """Take note of the bell: what is looked at from here on may ring it again."""
        with contextlib.suppress(BlockingIOError):
            os.eventfd_read(self._wake_event)

    def wait(self, seconds: float | None, commands: bool = True) -> bool:
        """Until the bell rings, a command comes (with `commands`), or `seconds` of wall time are
        over; whether a command is what came."""
        sources = (
            [self._wake_event, self._poll] if commands and self._streams else [self._wake_event]
        )
        ready, _, _ = select.select(sources, [], [], seconds)
        return self._poll in ready

    def add(self, stream: MessageStream) -> None:
        """Read this stream too."""
        # A closed socket's number may have come to be that of a new one.
        self._end(self._streams.pop(stream.descriptor, None))
        try:
            self._poll.register(stream.descriptor, select.EPOLLIN)
        except (OSError, ValueError):  # closed meanwhile
            self._end(stream)
            return
        self._streams[stream.descriptor] = stream

    def remove(self, stream: MessageStream) -> None:
        """Read it no more."""
        if self._streams.get(stream.descriptor) is stream:
            del self._streams[stream.descriptor]
            with contextlib.suppress(OSError, ValueError):
                self._poll.unregister(stream.descriptor)
        self._end(stream)

    def deliver(self, time_ns: int, backlog: int) -> bool:
        """Read what has come and hand on what acts in the step from `time_ns`; see Stream.act.

        Returns whether a command came.
        """
        if not self._streams:
            return False
        acted = False
        for descriptor, _ in self._poll.poll(0):
            stream = self._streams[descriptor]
            if not stream.read(self._buffer):
                acted = stream.deliver(time_ns, 0) or acted  # its last word
                self.remove(stream)
        for stream in self._streams.values():
            acted = stream.deliver(time_ns, backlog) or acted
        return acted

    def take_skipped_count(self) -> int:
        """Messages that one stream passed over since this was last asked, the most of any."""
        most = 0
        for stream in self._streams.values():
            most, stream.skipped_count = max(most, stream.skipped_count), 0
        return most

    def close(self) -> None:
        """End all streams."""
        for stream in list(self._streams.values()):
            self.remove(stream)

    @staticmethod
    def _end(stream: MessageStream | None) -> None:
        if stream is not None:
            stream.on_end()
