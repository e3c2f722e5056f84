"""The errors of the last seconds in one array, so that they are judged without being collected."""

from __future__ import annotations

import numpy as np


class RecentErrors:
    """Rows by stamp, the newest last."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget all."""
        self._stamps, self._rows = np.empty(64), np.empty((64, 0))
        self._start = self._end = 0

    def __len__(self) -> int:
        """How many there are."""
        return self._end - self._start

    @property
    def stamps(self) -> np.ndarray:
        """(m,) s, rising; a view until the next `add`."""
        return self._stamps[self._start : self._end]

    @property
    def errors(self) -> np.ndarray:
        """(m, k); a view until the next `add`."""
        return self._rows[self._start : self._end]

    def add(self, stamp: float, error: np.ndarray) -> None:
        """Note one error (k,); of another length than the last it is the first of a new row."""
        if self._rows.shape[1] != len(error):
            self.clear()
            self._rows = np.empty((len(self._stamps), len(error)))
        if self._end == len(self._stamps):
            self._make_room()
        self._stamps[self._end], self._rows[self._end] = stamp, error
        self._end += 1

    def drop_oldest(self, count: int) -> None:
        """Forget the oldest."""
        self._start += count

    def _make_room(self) -> None:
        """Begin at the front again, of arrays twice as long where more than half is in use."""
        kept = len(self)
        size = len(self._stamps) * (2 if 2 * kept > len(self._stamps) else 1)
        stamps, rows = np.empty(size), np.empty((size, self._rows.shape[1]))
        stamps[:kept], rows[:kept] = self.stamps, self.errors
        self._stamps, self._rows, self._start, self._end = stamps, rows, 0, kept
