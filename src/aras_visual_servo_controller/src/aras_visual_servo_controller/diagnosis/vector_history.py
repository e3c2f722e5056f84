"""Buffer of recent rows of numbers, such as errors, in one array, which is fast to evaluate."""

from __future__ import annotations

import numpy as np


class VectorHistory:
    """Recent rows of numbers, such as the errors of images, with their stamps, the newest last."""

    def __init__(self, span: float = np.inf, max_count: float = np.inf) -> None:
        """Create the history.

        Args:
            span: time from the oldest to the newest row, s; older rows are removed.
            max_count: largest number of rows; older rows are removed.
        """
        self._span, self._max_count = span, max_count
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
        """Return the length k of the rows; 0 if there are none."""
        return self._rows.shape[1]

    @property
    def stamps(self) -> np.ndarray:
        """Return the increasing stamps (m,), s.

        The array is a view that is valid until the next call of `add`.
        """
        return self._stamps[self._start : self._end]

    @property
    def rows(self) -> np.ndarray:
        """Return the rows (m, k).

        The array is a view that is valid until the next call of `add`.
        """
        return self._rows[self._start : self._end]

    def add(self, stamp: float, row: np.ndarray) -> None:
        """Add one row (k,); previous rows of another length are removed."""
        if self._rows.shape[1] != len(row):
            self.clear()
            self._rows = np.empty((len(self._stamps), len(row)))
        if self._end == len(self._stamps):
            self._make_room()
        self._stamps[self._end], self._rows[self._end] = stamp, row
        self._end += 1
        while self._stamps[self._start] < stamp - self._span:
            self._start += 1
        self._start = max(self._start, self._end - self._max_count)

    def drop_oldest(self, count: int) -> None:
        """Remove the `count` oldest rows."""
        self._start += count

    def _make_room(self) -> None:
        """Move the rows to the start of the arrays; double the arrays if more than half is in use.
        """
        count = len(self)
        size = len(self._stamps) * (2 if 2 * count > len(self._stamps) else 1)
        stamps, rows = np.empty(size), np.empty((size, self._rows.shape[1]))
        stamps[:count], rows[:count] = self.stamps, self.rows
        self._stamps, self._rows, self._start, self._end = stamps, rows, 0, count
