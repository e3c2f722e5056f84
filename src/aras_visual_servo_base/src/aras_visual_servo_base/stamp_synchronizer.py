"""Matching of messages that belong to one exposure but arrive on different topics."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any

# Largest number of exposures for which messages of some topics are still missing. If one topic is
# later than another by more exposures than this, exposures are lost.
MOST_PENDING = 8


class StampSynchronizer:
    """Matches messages of different kinds, such as 'image' and 'depth', with the same stamp."""

    def __init__(self, kinds: Sequence[str]) -> None:
        """Create a synchronizer for exposures of which each has one message of each kind."""
        self._kinds = tuple(kinds)
        self._pending: dict[Hashable, dict[str, Any]] = {}

    def add(self, kind: str, stamp: Hashable, message: Any) -> dict[str, Any] | None:
        """Add a message to the exposure with its stamp.

        Returns:
            The messages of the exposure by kind, if it is complete now; otherwise None. If it is
            complete, older incomplete exposures are discarded.
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
        """Discard all incomplete exposures."""
        self._pending.clear()
