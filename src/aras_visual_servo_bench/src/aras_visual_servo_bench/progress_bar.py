"""Progress bar on a terminal and in notebooks."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TextIO

WIDTH = 24  # number of characters of the bar
MIN_PERIOD = 0.1  # shortest time between two writes, s; a notebook sends each write to the browser


def format_bar(fraction: float) -> str:
    """Return a bar such as [####....] for a fraction from 0 to 1."""
    filled = int(fraction * WIDTH)
    return f"[{'#' * filled}{'.' * (WIDTH - filled)}]"


def can_overwrite(out: TextIO) -> bool:
    """Return whether a line written to `out` can be overwritten: on a terminal or in a notebook."""
    return out.isatty() or type(out).__module__.startswith("ipykernel.")


class ProgressBar:
    """Progress bar on a terminal or in a notebook; it writes nothing to files and pipes."""

    def __init__(self, out: TextIO, clock: Callable[[], float] = time.monotonic) -> None:
        self._out, self._can_overwrite, self._clock = out, can_overwrite(out), clock
        self._task, self._write_time = "", float("-inf")

    def show(self, fraction: float, task: str) -> None:
        """Show the finished fraction, 0 to 1, and the name of the current task."""
        if not self._can_overwrite:
            return
        now = self._clock()
        if task == self._task and fraction < 1.0 and now - self._write_time < MIN_PERIOD:
            return
        self._task, self._write_time = task, now
        self._out.write(f"\r{format_bar(fraction)} {100.0 * fraction:3.0f} % {task[-48:]}\x1b[K")
        self._out.flush()

    def close(self) -> None:
        """Erase the bar."""
        if self._can_overwrite:
            self._out.write("\r\x1b[K")
            self._out.flush()
