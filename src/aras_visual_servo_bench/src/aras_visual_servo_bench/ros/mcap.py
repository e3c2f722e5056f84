"""Conversion of bags to MCAP files (https://mcap.dev), which Foxglove reads without ROS."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import BinaryIO

import rosbag
from mcap.writer import Writer

from ..errors import BenchError
from .bag_file import open_bag


def convert(
    bag: Path, out: Path, progress: Callable[[float], None] = lambda part: None
) -> dict[str, int]:
    """Convert a bag, which may be unclosed, to an MCAP file.

    Args:
        bag: path of the bag.
        out: path of the MCAP file.
        progress: function that is called with the finished fraction, 0 to 1.

    Returns:
        The number of messages of each topic.

    Raises:
        BenchError: the bag cannot be read, or the file cannot be written. An incomplete file is
            deleted.
    """
    part = out.with_name(out.name + ".part")
    try:
        with open_bag(bag, f"cannot convert {bag} into {out}") as (source, _):
            with part.open("wb") as stream:
                counts = _copy_messages(source, stream, bag.name, progress)
            part.replace(out)
    except BenchError:
        part.unlink(missing_ok=True)
        raise
    return counts


def _copy_messages(
    source: rosbag.Bag, stream: BinaryIO, name: str, progress: Callable[[float], None]
) -> dict[str, int]:
    """Copy all messages of a bag into an MCAP stream without deserializing them.

    name: name of the bag, which is stored in the MCAP file.

    Returns:
        The number of messages of each topic.
    """
    writer = Writer(stream)
    writer.start("ros1", "aras_visual_servo_bench")

    @cache
    def add_schema(kind: str, md5: str, definition: str) -> int:
        return writer.register_schema(kind, "ros1msg", definition.encode())

    @cache
    def add_channel(topic: str, kind: str, md5: str, definition: str) -> int:
        return writer.register_channel(
            topic, "ros1", add_schema(kind, md5, definition), {"md5sum": md5, "topic": topic}
        )

    topics = source.get_type_and_topic_info().topics
    total = sum(one.message_count for one in topics.values())
    counts: Counter[str] = Counter()
    for number, (topic, raw, time) in enumerate(source.read_messages(list(topics), raw=True)):
        kind, data, md5, _, message_class = raw
        channel = add_channel(topic, kind, md5, message_class._full_text)
        stamp = time.to_nsec()
        writer.add_message(channel, stamp, data, stamp, counts[topic])
        counts[topic] += 1
        if number % 500 == 0:
            progress(number / total)
    writer.add_metadata("bag", {"source": name})
    writer.finish()
    return counts
