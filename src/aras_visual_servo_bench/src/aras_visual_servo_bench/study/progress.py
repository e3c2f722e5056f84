"""A line that says how far a study is: runs, rate, failures, time left."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import TextIO

EVERY = 10.0  # s between lines where there is no terminal


class Progress:
    """Told of every chunk; draws on a terminal, writes a line now and then elsewhere."""

    def __init__(
        self, total: int, done: int = 0, out: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        """`total`: runs of the study. `done`: of them, kept already."""
        self._total, self._before, self._done = total, done, done
        self._out = sys.stderr if out is None else out
        self._clock = clock
        self._began = clock()
        self._said = float("-inf")
        self.failed = 0

    def more(self, runs: int, failed: int) -> None:
        """So many runs are done, of which so many did not succeed."""
        self._done += runs
        self.failed += failed
        now = self._clock()
        terminal = self._out.isatty()
        if terminal or now - self._said >= EVERY or self._done == self._total:
            self._said = now
            self._out.write(f"\r{self.line()}\x1b[K" if terminal else f"{self.line()}\n")
            self._out.flush()

    def line(self) -> str:
        """As it stands."""
        part = self._done / self._total if self._total else 1.0
        spent = max(self._clock() - self._began, 1e-9)
        rate = (self._done - self._before) / spent
        left = (self._total - self._done) / rate if rate else float("inf")
        return (
            f"{bar(part)} {self._done}/{self._total} runs, "
            f"{rate:.3g}/s, {self.failed} without success, {duration(left)} left"
        )

    def close(self) -> None:
        """Leave the line."""
        if self._out.isatty():
            self._out.write("\n")
            self._out.flush()


def duration(seconds: float) -> str:
    """A time as people say it."""
    if seconds == float("inf"):
        return "unknown time"
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    if seconds < 5400.0:
        return f"{seconds / 60.0:.0f} min"
    if seconds < 172800.0:
        return f"{seconds / 3600.0:.1f} h"
    return f"{seconds / 86400.0:.1f} days"


def bar(part: float, width: int = 24) -> str:
    """[####....] for a part of 0 to 1."""
    filled = int(part * width)
    return f"[{'#' * filled}{'.' * (width - filled)}]"


class Bar:
    """A line that fills on a terminal; silent elsewhere."""

    def __init__(self, out: TextIO) -> None:
        self._out, self._shown = out, out.isatty()

    def show(self, part: float, what: str) -> None:
        """The part that is done, 0 to 1, and what is being done."""
        if self._shown:
            self._out.write(f"\r{bar(part)} {100.0 * part:3.0f} % {what[-48:]}\x1b[K")
            self._out.flush()

    def close(self) -> None:
        """Leave no half line."""
        if self._shown:
            self._out.write("\r\x1b[K")
