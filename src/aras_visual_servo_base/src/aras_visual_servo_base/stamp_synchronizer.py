"""Matching of messages that belong to one image but arrive through different connections."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any

# Largest number of incomplete images. It limits how much later the messages of one connection may
# arrive than those of another.
MOST_PENDING = 8


class StampSynchronizer:
    """Matches messages of different kinds that have the same stamp."""

    def __init__(self, kinds: Sequence[str]) -> None:
        """Create a synchronizer. A complete image has a message of each of these kinds."""
        self._kinds = tuple(kinds)
        self._pending: dict[Hashable, dict[str, Any]] = {}

    def add(self, kind: str, stamp: Hashable, message: Any) -> dict[str, Any] | None:
        """Add a message. If its image is complete now, return all messages of the image by kind.

        Older incomplete images are discarded in this case. Otherwise, return None.
        """
        entry = self._pending.setdefault(stamp, {})
        entry[kind] = message
        if len(entry) < len(self._kinds):
            while len(self._pending) > MOST_PENDING:
                del self._pending[next(iter(self._pending))]
            return None
        for older in list(self._pending):
            del self._pending[older]
            if older == stamp:
                break
        return entry

    def clear(self) -> None:
        """Discard all incomplete images."""
        self._pending.clear()
