"""Opening of bags, even if they were not closed."""

from __future__ import annotations

import contextlib
import io
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import BenchError

if TYPE_CHECKING:
    import rosbag

UNCLOSED_NOTE = (
    "the bag was not closed: it is still being recorded, or its recorder was killed. The report "
    "covers the complete chunks of the file."
)


@contextlib.contextmanager
def open_bag(path: Path, fault: str = "") -> Iterator[tuple[rosbag.Bag, str]]:
    """Open a bag for a `with` block, together with a note for the report.

    If the bag was not closed, the note is UNCLOSED_NOTE; otherwise it is ''.

    fault: start of the message if the bag cannot be opened, or if the `with` block cannot read it;
        '' for "cannot read the bag PATH".

    Raises:
        BenchError: the bag cannot be opened, or the `with` block cannot read it.
    """
    import rosbag

    try:
        try:
            bag, note = rosbag.Bag(str(path)), ""
        except rosbag.ROSBagUnindexedException:
            bag, note = _reindex(path), UNCLOSED_NOTE
        with bag:
            yield bag, note
    except (OSError, rosbag.ROSBagException, struct.error, ValueError, RuntimeError) as error:
        raise BenchError(f"{fault or f'cannot read the bag {path}'}: {error}") from error


def _reindex(path: Path) -> rosbag.Bag:
    """Index the complete chunks of an unclosed bag without changing the file."""
    import rosbag

    bag = rosbag.Bag(str(path), allow_unindexed=True)
    # The connection records at the end of the file may be incomplete, so they are not read. The
    # chunks contain the same records.
    bag._reader._read_terminal_connection_records = lambda: None
    # At its end, `reindex` tries to truncate the file. This fails, because the file is open for
    # reading only, and the error is ignored.
    with contextlib.suppress(io.UnsupportedOperation):
        for _ in bag.reindex():
            pass
    # the last chunk may be incomplete: drop the index entries of its messages
    for entries in bag._connection_indexes.values():
        entries[:] = [entry for entry in entries if entry.chunk_pos in bag._chunk_headers]
    bag._connection_indexes_read = True
    return bag
