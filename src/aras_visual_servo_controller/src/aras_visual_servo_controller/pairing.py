"""Messages of one image, brought together though they come over different connections."""

from __future__ import annotations

import threading
from collections.abc import Hashable, Sequence
from typing import Any

KEPT = 8  # images; the sum of what connections lag behind each other


class ByStamp:
    """Pairs messages of several kinds by their stamps."""

    def __init__(self, kinds: Sequence[str]) -> None:
        """`kinds`: what belongs to one image."""
        self._kinds = tuple(kinds)
        self._waiting: dict[Hashable, dict[str, Any]] = {}

    def add(self, kind: str, stamp: Hashable, message: Any) -> dict[str, Any] | None:
        """Take in one message; all of its image by kind when it was the last that was missing.

        Older images that are still incomplete will never be asked for again.
        """
        entry = self._waiting.setdefault(stamp, {})
        entry[kind] = message
        if len(entry) < len(self._kinds):
            while len(self._waiting) > KEPT:
                del self._waiting[next(iter(self._waiting))]
            return None
        for older in list(self._waiting):
            del self._waiting[older]
            if older == stamp:
                break
        return entry

    def clear(self) -> None:
        """Forget what waits."""
        self._waiting.clear()


class InTurn:
    """Pairs a stamped message with one that has no stamp and is sent right after it.

    The original's camera/data carries numbers alone. The camera node sends an image's moments and
    then its data: whichever arrives first waits for the other. Moments whose data never came (the
    camera node could make none) give way to the next.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._stamped: Any = None
        self._plain: Any = None
        self._to_come = False  # the numbers of an image that was passed over

    def stamped(self, message: Any) -> tuple[Any, Any] | None:
        """Take in the message with the stamp; the pair when its other half is there."""
        with self._lock:
            self._stamped, self._to_come = message, False
            return self._pair()

    def plain(self, message: Any) -> tuple[Any, Any] | None:
        """Take in the message without a stamp; likewise."""
        with self._lock:
            if self._to_come and self._stamped is None:
                self._to_come = False
                return None
            self._plain = message
            return self._pair()

    def passed_over(self) -> None:
        """The stamped message was of no use: its other half, which may come yet, is not either."""
        with self._lock:
            self._to_come = self._plain is None
            self._stamped = self._plain = None

    def _pair(self) -> tuple[Any, Any] | None:
        if self._stamped is None or self._plain is None:
            return None
        pair = self._stamped, self._plain
        self._stamped = self._plain = None
        return pair
