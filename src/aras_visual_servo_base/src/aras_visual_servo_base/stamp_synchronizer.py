"""Messages of one image, brought together though they come over different connections."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any

MOST_PENDING = 8  # images; the sum of what connections lag behind each other


class StampSynchronizer:
    """Pairs messages of several kinds by their stamps."""

    def __init__(self, kinds: Sequence[str]) -> None:
        """`kinds`: what belongs to one image."""
        self._kinds = tuple(kinds)
        self._pending: dict[Hashable, dict[str, Any]] = {}

    def add(self, kind: str, stamp: Hashable, message: Any) -> dict[str, Any] | None:
        """Take in one message; all of its image by kind when it was the last that was missing.

        Older images that are still incomplete will never be asked for again.
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
        """Forget what waits."""
        self._pending.clear()
