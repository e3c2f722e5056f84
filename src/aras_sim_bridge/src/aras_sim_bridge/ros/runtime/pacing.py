"""When simulated time may advance: at a multiple of real time, or as fast as it goes.

Reads the wall clock through a function, so that tests can hand in their own.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

log = logging.getLogger(__name__)

BATCH_NS = 4_000_000  # steps are made in groups of this much simulated time: few wake-ups, 250 Hz
LARGEST_LAG_NS = 200_000_000  # a lag beyond this is given up instead of made good at a gallop
WINDOW = 2.0  # seconds of wall time over which the real-time factor is measured
WARN_BELOW = 0.95  # of the wanted factor
WARN_PERIOD = 10.0  # seconds of wall time between two warnings


class FactorMeter:
    """Measures simulated over wall time in windows, and warns when it falls short."""

    def __init__(self, clock: Callable[[], float]) -> None:
        """`clock` gives seconds of wall time."""
        self.value = 0.0
        self._clock = clock
        self._last_warning = -WARN_PERIOD
        self.restart(0)

    def restart(self, time_ns: int) -> None:
        """Begin a new window at this simulated time."""
        self._wall = self._clock()
        self._time_ns = time_ns

    def update(self, time_ns: int, desired: float) -> None:
        """Take note of the simulated time reached now; `desired` 0 is content with anything."""
        now = self._clock()
        elapsed = now - self._wall
        if elapsed < WINDOW:
            return
        self.value = (time_ns - self._time_ns) / 1e9 / elapsed
        self.restart(time_ns)
        if self.value < WARN_BELOW * desired and now - self._last_warning >= WARN_PERIOD:
            self._last_warning = now
            log.warning(
                "cannot keep up: real-time factor %.2f instead of %g; free the processor, lower "
                "the cameras' rate or size, or set speed_mode to max",
                self.value,
                desired,
            )


class Pacer:
    """Simulated time follows wall time times `factor`; 0 means as fast as it goes.

    What is due is reckoned from the last restart, so rounding and late wake-ups do not add up.
    """

    def __init__(self, factor: float = 1.0, clock: Callable[[], float] = time.monotonic) -> None:
        """`clock` gives seconds of wall time."""
        self._factor = factor
        self._clock = clock
        self._meter = FactorMeter(clock)
        self.restart(0)

    @property
    def factor(self) -> float:
        """Wanted simulated seconds a second; 0: as many as possible."""
        return self._factor

    @property
    def real_time_factor(self) -> float:
        """Simulated seconds a second, measured over the last window."""
        return self._meter.value

    def set_factor(self, factor: float, time_ns: int) -> None:
        """Change the factor from this simulated time on."""
        self._factor = factor
        self.restart(time_ns)

    def restart(self, time_ns: int) -> None:
        """Take this simulated time as being now: after a pause, a reset, a jump."""
        self._wall = self._clock()
        self._start_ns = time_ns
        self._meter.restart(time_ns)

    def find_due_time(
        self, time_ns: int, event_ns: int | None = None, group_ns: int = BATCH_NS
    ) -> int:
        """Simulated time [ns] up to which steps are due now, having reached `time_ns`.

        event_ns: when something is to happen that shall not wait for the rest of its group. The
            step that contains it is due when it has come, so that time is ahead by a part of it.
        group_ns: simulated time of a group of steps that are made together.
        """
        self._meter.update(time_ns, self._factor)
        if self._factor <= 0.0:
            return (time_ns // group_ns + 1) * group_ns
        target = self._compute_target()
        lag = target - time_ns
        if lag > LARGEST_LAG_NS:
            self._start_ns -= lag - BATCH_NS
            target = time_ns + BATCH_NS
        end = target // group_ns * group_ns
        return end if event_ns is None or event_ns > target else max(end, event_ns)

    def compute_wait(
        self, time_ns: int, event_ns: int | None = None, group_ns: int = BATCH_NS
    ) -> float:
        """Seconds of wall time until the next steps are due; may be negative."""
        if self._factor <= 0.0:
            return 0.0
        next_ns = (time_ns // group_ns + 1) * group_ns
        if event_ns is not None and event_ns > time_ns:
            next_ns = min(next_ns, event_ns)
        return (next_ns - self._compute_target()) / 1e9 / self._factor

    def _compute_target(self) -> int:
        elapsed = self._clock() - self._wall
        return self._start_ns + round(elapsed * 1e9 * self._factor)
