"""Matching of messages that belong to one exposure of a camera but arrive on different topics."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any

# Largest number of incomplete exposures that are stored until their other messages arrive. If there
# are more, the oldest is discarded.
MOST_PENDING = 8


class StampSynchronizer:
    """Matches messages of different kinds, such as 'image' and 'depth', with the same stamp."""

    def __init__(self, kinds: Sequence[str]) -> None:
        """Create a synchronizer for exposures of a camera that have one message of each kind."""
        self._kinds = tuple(kinds)
        self._pending: dict[Hashable, dict[str, Any]] = {}

    def add(self, kind: str, stamp: Hashable, message: Any) -> dict[str, Any] | None:
        """Add a message to the exposure with its stamp.

        Returns:
            The messages of the exposure by kind, if this message completes it; otherwise None. A
            complete exposure discards all older incomplete exposures.
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
        """Discard the messages of all incomplete exposures."""
        self._pending.clear()
