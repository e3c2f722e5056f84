"""Buffer of recent rows of numbers, such as errors, in one array, which is fast to evaluate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


class VectorHistory:
    """Recent rows of numbers, such as the errors of images, with their stamps, the newest last.

    Attributes:
        stamps: (m,) increasing stamps, s.
        rows: (m, k) rows; (0, 0) before the first. Both arrays are views that are valid until the
            next call of a method.
    """

    def __init__(self, span: float = np.inf, max_count: float = np.inf) -> None:
        """Create the history.

        Args:
            span: time from the oldest to the newest row, s; older rows are removed.
            max_count: largest number of rows; older rows are removed.
        """
        self._span, self._max_count = span, max_count
        self._stamps, self._rows = np.empty(64), np.empty((64, 0))
        self.clear()

    def clear(self) -> None:
        """Remove all rows."""
        self._start = self._end = 0
        self.stamps, self.rows = self._stamps[:0], self._rows[:0]

    def add(self, stamp: float | Sequence[float], row: np.ndarray) -> None:
        """Add one row (k,); previous rows of another length are removed.

        Several rows (j, k) can be added together, with their stamps (j,).
        """
        if row.shape[-1] != self._rows.shape[1]:
            self._rows = np.empty((self._stamps.size, row.shape[-1]))
            self.clear()
        count = 1 if row.ndim == 1 else len(row)
        if self._end + count > self._stamps.size:
            self._make_room()
        stamps, rows, start, end = self._stamps, self._rows, self._start, self._end + count
        stamps[end - count : end], rows[end - count : end] = stamp, row
        while stamps[start] < stamps[end - 1] - self._span:
            start += 1
        if end - start > self._max_count:
            start = end - self._max_count
        self._start, self._end = start, end
        self.stamps, self.rows = stamps[start:end], rows[start:end]

    def drop_oldest(self, count: int) -> None:
        """Remove the `count` oldest rows."""
        self._start += count
        self.stamps, self.rows = self.stamps[count:], self.rows[count:]

    def _make_room(self) -> None:
        """Move the rows to the start of the arrays; double the arrays if more than half is in use.
        """
        count, size = self._end - self._start, self._stamps.size
        size *= 2 if 2 * count > size else 1
        stamps, rows = np.empty(size), np.empty((size, self._rows.shape[1]))
        stamps[:count], rows[:count] = self.stamps, self.rows
        self._stamps, self._rows, self._start, self._end = stamps, rows, 0, count
