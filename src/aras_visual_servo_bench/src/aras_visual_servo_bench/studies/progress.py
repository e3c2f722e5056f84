"""A line that says how far a study is: runs, rate, failures, time left."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TextIO

from ..metrics.formatting import format_number

LINE_PERIOD = 10.0  # s between lines where there is no terminal
WIDTH = 24  # characters of a bar


class Progress:
    """Told of every chunk; draws on a terminal, writes a line now and then elsewhere."""

    def __init__(
        self, total: int, finished: int = 0, out: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        """`total`: runs of the study. `finished`: of them, kept already."""
        self._total, self._finished = total, finished
        self._out = sys.stderr if out is None else out
        self._clock = clock
        self._first: tuple[float, int] | None = None  # when the first came, and how many were done
        self._print_time = float("-inf")
        self._warm_workers: set[str] = set()  # workers that have done a run
        self._workers, self._timed_runs, self._wall_time = 1, 0, 0.0
        self.failed = 0

    def add_runs(
        self, runs: int, failed: int, times: Sequence[Mapping[str, Any]] = (), workers: int = 1
    ) -> None:
        """So many runs are done, of which so many did not succeed.

        Args:
            times: rows of their wall times; see rows.TIMES.
            workers: that share what is left.
        """
        self._finished += runs
        self.failed += failed
        self._workers = max(workers, 1)
        for row in times:
            if row["worker"] in self._warm_workers:  # its first run may have compiled loops
                self._timed_runs += 1
                self._wall_time += row.get("wall", 0.0)
            self._warm_workers.add(row["worker"])
        now = self._clock()
        self._first = self._first or (now, self._finished)
        terminal = self._out.isatty()
        if terminal or now - self._print_time >= LINE_PERIOD or self._finished == self._total:
            self._print_time = now
            self._out.write(f"\r{self.make_line()}\x1b[K" if terminal else f"{self.make_line()}\n")
            self._out.flush()

    def make_line(self) -> str:
        """As it stands."""
        part = self._finished / self._total if self._total else 1.0
        each = self._compute_time_per_run()
        left = (self._total - self._finished) * each if self._finished < self._total else 0.0
        rate = f"{format_number(1.0 / each)}/s, " if 0.0 < each < math.inf else ""
        return (
            f"{format_bar(part)} {self._finished}/{format_count(self._total, 'run')}, "
            f"{rate}{self.failed} without "
            f"success, {format_duration(left)} left"
        )

    def _compute_time_per_run(self) -> float:
        """Seconds from one run to the next, without those of the start; inf: not known yet.

        By the runs' own wall times, which hold from the first chunk on; or by the clock, where
        that is slower: the workers then wait for chunks.
        """
        if self._first is None or not self._timed_runs:
            return math.inf
        when, before = self._first
        done = self._finished - before
        by_clock = (self._clock() - when) / done if done else 0.0
        return max(self._wall_time / self._timed_runs / self._workers, by_clock)

    def close(self) -> None:
        """Leave the line."""
        if self._out.isatty():
            self._out.write("\n")
            self._out.flush()


def format_count(number: int, what: str) -> str:
    """'1 run', '2 runs'."""
    return f"{number} {what}" + ("" if number == 1 else "s")


def format_duration(seconds: float) -> str:
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


def format_bar(fraction: float) -> str:
    """[####....] for a part of 0 to 1."""
    filled = int(fraction * WIDTH)
    return f"[{'#' * filled}{'.' * (WIDTH - filled)}]"


class ProgressBar:
    """A line that fills on a terminal; silent elsewhere."""

    def __init__(self, out: TextIO) -> None:
        self._out, self._line = out, out.isatty()

    def show(self, fraction: float, task: str) -> None:
        """The part that is done, 0 to 1, and what is being done."""
        if self._line:
            self._out.write(
                f"\r{format_bar(fraction)} {100.0 * fraction:3.0f} % {task[-48:]}\x1b[K"
            )
            self._out.flush()

    def close(self) -> None:
        """Leave no half line."""
        if self._line:
            self._out.write("\r\x1b[K")
