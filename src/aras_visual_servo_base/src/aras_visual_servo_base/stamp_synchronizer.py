"""Synchronisation of messages of one image that arrive through different connections."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any

MOST_PENDING = 8  # incomplete images; limits the delay between the connections


class StampSynchronizer:
    """Matches messages of several kinds by their stamps."""

    def __init__(self, kinds: Sequence[str]) -> None:
        """Create a synchronizer for these kinds of messages, which together form one image."""
        self._kinds = tuple(kinds)
        self._pending: dict[Hashable, dict[str, Any]] = {}

    def add(self, kind: str, stamp: Hashable, message: Any) -> dict[str, Any] | None:
        """Add a message; return all messages of its image, by kind, if the image is now complete.

        Older incomplete images are then discarded.
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
