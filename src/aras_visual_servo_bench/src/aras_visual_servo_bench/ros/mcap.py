"""Bags as MCAP files, which Foxglove and its libraries read without ROS.

Written by the format's specification, https://mcap.dev/spec: chunks packed by LZ4 with an index of
each, and a summary at the end, so that a reader finds any time without reading all.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from ..errors import BenchError

MAGIC = b"\x89MCAP0\r\n"
(HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX) = range(1, 9)
STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = 0x0B, 0x0C, 0x0D, 0x0E, 0x0F
CHUNK_SIZE = 1_000_000  # bytes before packing
LIBRARY = "aras_visual_servo_bench"


def _text(text: str) -> bytes:
    data = text.encode()
    return struct.pack("<I", len(data)) + data


def _map(pairs: Mapping[Any, Any], key: Callable[[Any], bytes], value: Callable[[Any], bytes]
         ) -> bytes:  # fmt: skip
    data = b"".join(key(k) + value(v) for k, v in pairs.items())
    return struct.pack("<I", len(data)) + data


def _u16(number: int) -> bytes:
    return struct.pack("<H", number)


def _u64(number: int) -> bytes:
    return struct.pack("<Q", number)


def _record(code: int, content: bytes) -> bytes:
    return struct.pack("<BQ", code, len(content)) + content


class McapWriter:
    """Messages of ROS 1 into a stream, in the order in which they come; close it at the end."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream, self._at = stream, 0
        self._channels: dict[tuple[str, str, str], int] = {}
        self._schemas: dict[tuple[str, str], int] = {}
        self._definitions: list[bytes] = []  # records of schemas and channels, for the summary
        self._counts: dict[int, int] = {}
        self._chunk: list[bytes] = []
        self._size = 0
        self._index: dict[int, list[tuple[int, int]]] = {}
        self._span = [2**64 - 1, 0]
        self._whole = [2**64 - 1, 0]
        self._chunks: list[bytes] = []
        self._metadata: list[bytes] = []
        self._put(MAGIC)
        self._put(_record(HEADER, _text("ros1") + _text(LIBRARY)))

    def write(
        self, topic: str, kind: str, md5: str, definition: str, data: bytes, time: int
    ) -> None:
        """One message. kind: 'package/Type'. definition: its text. time: ns."""
        channel = self._channel(topic, kind, md5, definition)
        sequence = self._counts[channel]
        self._counts[channel] += 1
        self._index.setdefault(channel, []).append((time, self._size))
        self._add(_record(MESSAGE, struct.pack("<HIQQ", channel, sequence & 0xFFFFFFFF, time, time)
                          + data))  # fmt: skip
        self._span = [min(self._span[0], time), max(self._span[1], time)]
        if self._size >= CHUNK_SIZE:
            self._flush()

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Words about the whole file."""
        record = _record(METADATA, _text(name) + _map(values, _text, _text))
        self._metadata.append(
            _record(METADATA_INDEX, _u64(self._at) + _u64(len(record)) + _text(name))
        )
        self._put(record)

    def close(self) -> None:
        """The last chunk and the summary; nothing can be written after it."""
        self._flush()
        self._put(_record(DATA_END, struct.pack("<I", 0)))
        start, groups = self._at, []
        schemas = [r for r in self._definitions if r[0] == SCHEMA]
        channels = [r for r in self._definitions if r[0] == CHANNEL]
        first, last = self._whole if self._counts else (0, 0)
        total = sum(self._counts.values())
        statistics = _record(STATISTICS, struct.pack(
            "<QHIIIIQQ", total, len(schemas), len(channels), 0, len(self._metadata),
            len(self._chunks), first, last,
        ) + _map(self._counts, _u16, _u64))  # fmt: skip
        for code, records in (
            (SCHEMA, schemas), (CHANNEL, channels), (STATISTICS, [statistics]),
            (CHUNK_INDEX, self._chunks), (METADATA_INDEX, self._metadata),
        ):  # fmt: skip
            if records:
                begin = self._at
                self._put(b"".join(records))
                groups.append(_record(
                    SUMMARY_OFFSET, struct.pack("<BQQ", code, begin, self._at - begin)
                ))  # fmt: skip
        offsets = self._at
        self._put(b"".join(groups))
        self._put(_record(FOOTER, struct.pack("<QQI", start, offsets, 0)))
        self._put(MAGIC)

    # -- within ----------------------------------------------------------------------------

    def _channel(self, topic: str, kind: str, md5: str, definition: str) -> int:
        """Number of the channel; its records go into the chunk where it is new."""
        known = (topic, kind, md5)
        if known in self._channels:
            return self._channels[known]
        schema = self._schemas.get((kind, md5))
        if schema is None:
            schema = self._schemas[kind, md5] = len(self._schemas) + 1
            text = definition.encode()
            self._define(_record(SCHEMA, _u16(schema) + _text(kind) + _text("ros1msg")
                                 + struct.pack("<I", len(text)) + text))  # fmt: skip
        channel = self._channels[known] = len(self._channels)
        self._counts[channel] = 0
        self._define(_record(
            CHANNEL, _u16(channel) + _u16(schema) + _text(topic) + _text("ros1")
            + _map({"md5sum": md5, "topic": topic}, _text, _text),
        ))  # fmt: skip
        return channel

    def _define(self, record: bytes) -> None:
        self._definitions.append(record)
        self._add(record)

    def _add(self, record: bytes) -> None:
        self._chunk.append(record)
        self._size += len(record)

    def _flush(self) -> None:
        """Pack and write the chunk, and its index behind it."""
        if not self._chunk:
            return
        records = b"".join(self._chunk)
        packed, how = _packed(records)
        first, last = self._span if self._index else (0, 0)
        start = self._at
        self._put(_record(CHUNK, struct.pack("<QQQI", first, last, len(records),
                                             zlib.crc32(records)) + _text(how)
                          + _u64(len(packed)) + packed))  # fmt: skip
        length, indexes = self._at - start, {}
        begin = self._at
        for channel, entries in self._index.items():
            indexes[channel] = self._at
            rows = b"".join(struct.pack("<QQ", *entry) for entry in sorted(entries))
            self._put(_record(MESSAGE_INDEX, _u16(channel) + struct.pack("<I", len(rows)) + rows))
        self._chunks.append(_record(CHUNK_INDEX, struct.pack("<QQQQ", first, last, start, length)
                                    + _map(indexes, _u16, _u64) + _u64(self._at - begin)
                                    + _text(how) + _u64(len(packed)) + _u64(len(records))
                                    ))  # fmt: skip
        self._whole = [min(self._whole[0], first), max(self._whole[1], last)]
        self._chunk, self._size, self._index = [], 0, {}
        self._span = [2**64 - 1, 0]

    def _put(self, data: bytes) -> None:
        self._stream.write(data)
        self._at += len(data)


def _packed(records: bytes) -> tuple[bytes, str]:
    """By LZ4 where ROS has it."""
    try:
        import roslz4
    except ImportError:
        return records, ""
    return roslz4.compress(records), "lz4"


def convert(
    bag: Path, out: Path, progress: Callable[[float], None] = lambda part: None
) -> dict[str, int]:
    """A bag, closed or not, as an MCAP file; how many messages each topic has.

    Raises:
        BenchError: the bag cannot be read, or the file not be written; none is left behind then.
    """
    import rosbag

    from .bag import opened

    counts: dict[str, int] = {}
    part = out.with_name(out.name + ".part")
    try:
        source, _ = opened(bag)
        with source, part.open("wb") as stream:
            topics = source.get_type_and_topic_info().topics
            total = sum(one.message_count for one in topics.values()) or 1
            writer = McapWriter(stream)
            for number, (topic, raw, time) in enumerate(
                source.read_messages(list(topics), raw=True)
            ):
                kind, data, md5, _, made = raw
                writer.write(topic, kind, md5, made._full_text, data, time.to_nsec())
                counts[topic] = counts.get(topic, 0) + 1
                if number % 500 == 0:
                    progress(number / total)
            writer.metadata("bag", {"source": bag.name})
            writer.close()
        part.replace(out)
    except (OSError, rosbag.ROSBagException, struct.error, ValueError, RuntimeError) as error:
        part.unlink(missing_ok=True)
        raise BenchError(f"cannot convert {bag} into {out}: {error}") from error
    return counts
