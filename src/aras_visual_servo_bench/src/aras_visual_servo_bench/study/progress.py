"""A line that says how far a study is: runs, rate, failures, time left."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TextIO

from ..numbers.printing import number

EVERY = 10.0  # s between lines where there is no terminal
WIDTH = 24  # characters of a bar


class Progress:
    """Told of every chunk; draws on a terminal, writes a line now and then elsewhere."""

    def __init__(
        self, total: int, done: int = 0, out: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        """`total`: runs of the study. `done`: of them, kept already."""
        self._total, self._done = total, done
        self._out = sys.stderr if out is None else out
        self._clock = clock
        self._first: tuple[float, int] | None = None  # when the first came, and how many were done
        self._said = float("-inf")
        self._known: set[str] = set()  # workers that have done a run
        self._workers, self._timed, self._wall = 1, 0, 0.0
        self.failed = 0

    def more(
        self, runs: int, failed: int, times: Sequence[Mapping[str, Any]] = (), workers: int = 1
    ) -> None:
        """So many runs are done, of which so many did not succeed.

        Args:
            times: rows of their wall times; see rows.TIMES.
            workers: that share what is left.
        """
        self._done += runs
        self.failed += failed
        self._workers = max(workers, 1)
        for row in times:
            if row["worker"] in self._known:  # its first run may have compiled loops
                self._timed += 1
                self._wall += row.get("wall", 0.0)
            self._known.add(row["worker"])
        now = self._clock()
        self._first = self._first or (now, self._done)
        terminal = self._out.isatty()
        if terminal or now - self._said >= EVERY or self._done == self._total:
            self._said = now
            self._out.write(f"\r{self.line()}\x1b[K" if terminal else f"{self.line()}\n")
            self._out.flush()

    def line(self) -> str:
        """As it stands."""
        part = self._done / self._total if self._total else 1.0
        each = self._each()
        left = (self._total - self._done) * each if self._done < self._total else 0.0
        rate = f"{number(1.0 / each)}/s, " if 0.0 < each < math.inf else ""
        return (
            f"{bar(part)} {self._done}/{counted(self._total, 'run')}, {rate}{self.failed} without "
            f"success, {duration(left)} left"
        )

    def _each(self) -> float:
        """Seconds from one run to the next, without those of the start; inf: not known yet.

        By the runs' own wall times, which hold from the first chunk on; or by the clock, where
        that is slower: the workers then wait for chunks.
        """
        if self._first is None or not self._timed:
            return math.inf
        when, before = self._first
        done = self._done - before
        by_clock = (self._clock() - when) / done if done else 0.0
        return max(self._wall / self._timed / self._workers, by_clock)

    def close(self) -> None:
        """Leave the line."""
        if self._out.isatty():
            self._out.write("\n")
            self._out.flush()


def counted(number: int, what: str) -> str:
    """'1 run', '2 runs'."""
    return f"{number} {what}" + ("" if number == 1 else "s")


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


def bar(part: float) -> str:
    """[####....] for a part of 0 to 1."""
    filled = int(part * WIDTH)
    return f"[{'#' * filled}{'.' * (WIDTH - filled)}]"


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
