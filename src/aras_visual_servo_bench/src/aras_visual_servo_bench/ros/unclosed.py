"""A bag that was never closed, read as far as it is whole; the file is left as it is.

A recorder writes its index when it closes the bag. Until then there are only the chunks, one after
the other, and of the last one perhaps a part. Format: http://wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import bz2
import struct
from collections.abc import Callable, Container, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, CHUNK, CONNECTION = 0x02, 0x05, 0x07
INDEX, CHUNK_INFO, FILE = 0x04, 0x06, 0x03
KNOWN = (MESSAGE, CHUNK, CONNECTION, INDEX, CHUNK_INFO, FILE)


@dataclass
class Topic:
    """What a bag tells of a topic: type and number of messages."""

    msg_type: str
    message_count: int = 0


@dataclass(frozen=True)
class _Chunk:
    """Where a chunk's data lie, how they are packed, and the times (ns) that they span."""

    offset: int
    size: int
    compression: str
    first: int
    last: int


class UnclosedBag:
    """The part of rosbag.Bag that a report uses."""

    def __init__(self, path: Path) -> None:
        """Looks through the whole file; ValueError where it is no bag."""
        self._file = path.open("rb")
        if self._file.read(len(MAGIC)) != MAGIC:
            self._file.close()
            raise ValueError("this is not a bag of version 2.0")
        self.topics: dict[str, Topic] = {}
        self._connections: dict[int, tuple[str, str, str, str]] = {}
        self._classes: dict[int, type] = {}
        self._chunks: list[_Chunk] = []
        self._look_through()

    def __enter__(self) -> UnclosedBag:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def get_type_and_topic_info(self) -> UnclosedBag:
        """As rosbag's: what has `topics`."""
        return self

    def read_messages(
        self, topics: Container[str], raw: bool = True, start_time: Any = None, end_time: Any = None
    ) -> Iterator[tuple[str, tuple, Any]]:
        """As rosbag's raw ones: topic, (type, bytes, md5, position, class), time."""
        import genpy

        begin = 0 if start_time is None else start_time.to_nsec()
        end = 2**63 if end_time is None else end_time.to_nsec()
        for chunk in self._chunks:
            if chunk.last < begin or chunk.first > end:
                continue
            for count, (number, time, data) in enumerate(self._messages(chunk)):
                topic, kind, md5, _ = self._connections[number]
                if topic in topics and begin <= time <= end:
                    made = genpy.Time(*divmod(time, 1_000_000_000))
                    place = (chunk.offset, count)
                    yield topic, (kind, data, md5, place, self._class(number)), made

    # -- the file --------------------------------------------------------------------------

    def _look_through(self) -> None:
        for header, offset, size in _records(self._file):
            if _op(header) != CHUNK:
                continue
            compression = header.get("compression", b"none").decode()
            whole = _Chunk(offset, size, compression, 0, 2**63)
            times = []
            for number, time, _ in self._messages(whole):
                self.topics[self._connections[number][0]].message_count += 1
                times.append(time)
            if times:
                self._chunks.append(_Chunk(offset, size, compression, min(times), max(times)))
            self._file.seek(offset + size)

    def _messages(self, chunk: _Chunk) -> Iterator[tuple[int, int, bytes]]:
        """Connection, time (ns) and bytes of each message; connections are taken in on the way."""
        import io

        self._file.seek(chunk.offset)
        inside = io.BytesIO(_unpacker(chunk.compression)(self._file.read(chunk.size)))
        for header, _, size in _records(inside):
            data = inside.read(size)
            if _op(header) == CONNECTION:
                self._take(header, data)
            elif _op(header) == MESSAGE:
                (number,) = struct.unpack("<I", header["conn"])
                secs, nsecs = struct.unpack("<II", header["time"])
                if number in self._connections:
                    yield number, secs * 1_000_000_000 + nsecs, data

    def _take(self, header: dict[str, bytes], data: bytes) -> None:
        (number,) = struct.unpack("<I", header["conn"])
        if number in self._connections:
            return
        fields = _fields(data)
        topic, kind = header["topic"].decode(), fields["type"].decode()
        self._connections[number] = (
            topic, kind, fields["md5sum"].decode(), fields["message_definition"].decode(),
        )  # fmt: skip
        self.topics.setdefault(topic, Topic(kind))

    def _class(self, number: int) -> type:
        """Of the messages as they were defined when they were recorded."""
        import genpy.dynamic

        if number not in self._classes:
            _, kind, _, definition = self._connections[number]
            self._classes[number] = genpy.dynamic.generate_dynamic(kind, definition)[kind]
        return self._classes[number]


def _records(stream: BinaryIO) -> Iterator[tuple[dict[str, bytes], int, int]]:
    """Header, where its data begin, and their size, of each whole record; the stream then stands at
    the data."""
    position = stream.tell()
    end = stream.seek(0, 2)
    while True:
        stream.seek(position)
        length = _length(stream)
        if length is None or position + 8 + length > end:
            return
        try:
            header = _fields(stream.read(length))
        except (ValueError, struct.error):
            return
        size = _length(stream)
        offset = position + 8 + length
        if size is None or offset + size > end or _op(header) not in KNOWN:
            return
        yield header, offset, size
        position = offset + size


def _length(stream: BinaryIO) -> int | None:
    data = stream.read(4)
    return struct.unpack("<I", data)[0] if len(data) == 4 else None


def _fields(data: bytes) -> dict[str, bytes]:
    """name=value of a record's header; ValueError where it is none."""
    found, at = {}, 0
    while at < len(data):
        (length,) = struct.unpack_from("<I", data, at)
        if length == 0 or at + 4 + length > len(data):
            raise ValueError("a header's field is cut off")
        name, equals, value = data[at + 4 : at + 4 + length].partition(b"=")
        if not equals:
            raise ValueError("a header's field has no value")
        found[name.decode(errors="replace")] = value
        at += 4 + length
    return found


def _op(header: dict[str, bytes]) -> int:
    return (header.get("op") or b"\0")[0]


def _unpacker(compression: str) -> Callable[[bytes], bytes]:
    if compression == "bz2":
        return bz2.decompress
    if compression == "lz4":
        import roslz4

        return roslz4.decompress
    return bytes
