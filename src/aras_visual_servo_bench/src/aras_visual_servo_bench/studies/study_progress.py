"""Progress lines of a study: finished runs, rate, failures and remaining time."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TextIO

from ..metrics.formatting import format_count, format_number
from ..progress_bar import can_overwrite, format_bar

# time between two lines of progress, s, if the output is neither a terminal nor a notebook
LINE_PERIOD = 10.0


class StudyProgress:
    """Display of a study's progress: a bar on a terminal and in notebooks, else a line every 10 s.

    Attributes:
        failed: number of runs without success.
    """

    def __init__(
        self, total: int, finished: int = 0, out: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        """Start the display of the progress.

        Args:
            total: number of runs of the study.
            finished: number of runs that are already stored.
            out: output; None: the standard error.
            clock: function that returns the time, s.
        """
        self._total, self._finished = total, finished
        self._out = sys.stderr if out is None else out
        self._clock = clock
        # Time at which the first chunk of runs was finished, s, and number of runs finished by
        # then.
        self._first: tuple[float, int] | None = None
        self._print_time = float("-inf")
        # names of the workers that have finished at least one run
        self._warm_workers: set[str] = set()
        self._workers, self._timed_runs, self._wall_time = 1, 0, 0.0
        self.failed = 0

    def add_runs(
        self, runs: int, failed: int, times: Sequence[Mapping[str, Any]] = (), workers: int = 1
    ) -> None:
        """Add finished runs.

        Args:
            runs: number of finished runs.
            failed: number of these runs that were without success.
            times: wall times of these runs, with the columns of rows.TIMES_SCHEMA.
            workers: number of workers for the remaining runs.
        """
        self._finished += runs
        self.failed += failed
        self._workers = max(workers, 1)
        for row in times:
            # The first run of a worker may include compilation, so the time of this run is not
            # counted.
            if row["worker"] in self._warm_workers:
                self._timed_runs += 1
                self._wall_time += row.get("wall", 0.0)
            self._warm_workers.add(row["worker"])
        now = self._clock()
        self._first = self._first or (now, self._finished)
        overwrites = can_overwrite(self._out)
        if overwrites or now - self._print_time >= LINE_PERIOD or self._finished == self._total:
            self._print_time = now
            line = self.make_line()
            self._out.write(f"\r{line}\x1b[K" if overwrites else f"{line}\n")
            self._out.flush()

    def make_line(self) -> str:
        """Return the current progress as one line."""
        fraction = self._finished / self._total if self._total else 1.0
        each = self._compute_time_per_run()
        remaining = (self._total - self._finished) * each if self._finished < self._total else 0.0
        rate = f"{format_number(1.0 / each)}/s, " if 0.0 < each < math.inf else ""
        return (
            f"{format_bar(fraction)} {self._finished}/{format_count(self._total, 'run')}, "
            f"{rate}{self.failed} without success, {format_duration(remaining)} left"
        )

    def _compute_time_per_run(self) -> float:
        """Estimate the time per run with all workers, s; return inf if it is not yet known.

        The result is the larger of two estimates: the mean wall time of a run, divided by the
        number of workers; and the time since the first chunk, divided by the number of runs
        finished since then. The second is larger if workers have to wait.
        """
        if self._first is None or not self._timed_runs:
            return math.inf
        start, before = self._first
        finished = self._finished - before
        by_clock = (self._clock() - start) / finished if finished else 0.0
        return max(self._wall_time / self._timed_runs / self._workers, by_clock)

    def close(self) -> None:
        """End the progress display: write a line break if the output is a terminal or a notebook.
        """
        if can_overwrite(self._out):
            self._out.write("\n")
            self._out.flush()


def format_duration(seconds: float) -> str:
    """Return a duration as text, in s, min, h or days."""
    if seconds == float("inf"):
        return "unknown time"
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    if seconds < 5400.0:
        return f"{seconds / 60.0:.0f} min"
    if seconds < 172800.0:
        return f"{seconds / 3600.0:.1f} h"
    return f"{seconds / 86400.0:.1f} days"
