"""Buffer of recent rows of numbers, such as errors, in one array, which is fast to evaluate."""

from __future__ import annotations

import numpy as np


class VectorHistory:
    """Recent rows of numbers, such as the errors of images, with their stamps, the newest last."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Remove all rows."""
        self._stamps, self._rows = np.empty(64), np.empty((64, 0))
        self._start = self._end = 0

    def __len__(self) -> int:
        """Return the number of rows."""
        return self._end - self._start

    @property
    def width(self) -> int:
        """Return the length k of the rows."""
        return self._rows.shape[1]

    @property
    def stamps(self) -> np.ndarray:
        """Return the increasing stamps (m,), s.

        The array is a view that is valid until the next call of `add`.
        """
        return self._stamps[self._start : self._end]

    @property
    def errors(self) -> np.ndarray:
        """Return the rows (m, k).

        The array is a view that is valid until the next call of `add`.
        """
        return self._rows[self._start : self._end]

    def add(self, stamp: float, error: np.ndarray) -> None:
        """Add one row (k,); previous rows of another length are removed."""
        if self._rows.shape[1] != len(error):
            self.clear()
            self._rows = np.empty((len(self._stamps), len(error)))
        if self._end == len(self._stamps):
            self._make_room()
        self._stamps[self._end], self._rows[self._end] = stamp, error
        self._end += 1

    def drop_before(self, stamp: float) -> None:
        """Remove the rows with an earlier stamp (s)."""
        while self._start < self._end and self._stamps[self._start] < stamp:
            self._start += 1

    def drop_oldest(self, count: int) -> None:
        """Remove the `count` oldest rows."""
        self._start += count

    def _make_room(self) -> None:
        """Move the rows to the start of the arrays; double the arrays if more than half is in use.
        """
        count = len(self)
        size = len(self._stamps) * (2 if 2 * count > len(self._stamps) else 1)
        stamps, rows = np.empty(size), np.empty((size, self._rows.shape[1]))
        stamps[:count], rows[:count] = self.stamps, self.errors
        self._stamps, self._rows, self._start, self._end = stamps, rows, 0, count
