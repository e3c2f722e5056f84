"""Pacing of simulated time: at a multiple of real time or as fast as possible.

The wall clock is read through a function, so that tests can replace it.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

log = logging.getLogger(__name__)

# Simulated time of a group of steps, ns. The simulation thread wakes up once for each group, that
# is at 250 Hz.
BATCH_NS = 4_000_000
# If simulated time lags behind real time by more than this, ns of simulated time, it continues from
# there and does not catch up.
LARGEST_LAG_NS = 200_000_000
WINDOW = 2.0  # time over which the real-time factor is measured, s of wall time
WARN_BELOW = 0.95  # fraction of the desired real-time factor below which a warning is logged
WARN_PERIOD = 10.0  # shortest time between two warnings about the real-time factor, s of wall time


class Pacer:
    """Pacer that advances simulated time `factor` times as fast as wall time.

    A factor of 0 means as fast as possible. The time at which a step is due is computed from the
    wall time since the last call of `restart`, so that rounding errors and late wake-ups do not
    accumulate.

    Attributes:
        factor: desired real-time factor; 0 means as fast as possible. Call `set_factor` to change
            it.
        real_time_factor: real-time factor measured over the last WINDOW seconds.
    """

    def __init__(self, factor: float = 1.0, clock: Callable[[], float] = time.monotonic) -> None:
        """Create a pacer; `clock` returns the wall time, s."""
        self.factor = factor
        self.real_time_factor = 0.0
        self._clock = clock
        self._last_warning = -WARN_PERIOD
        self.restart(0)

    def set_factor(self, factor: float, time_ns: int) -> None:
        """Change the desired factor from the simulated time `time_ns` on."""
        self.factor = factor
        self.restart(time_ns)

    def restart(self, time_ns: int) -> None:
        """Align the simulated time `time_ns` with the current wall time, e.g. after a pause."""
        self._wall = self._clock()
        self._start_ns = time_ns
        self._window_wall, self._window_ns = self._wall, time_ns

    def find_due_time(
        self, time_ns: int, event_ns: int | None = None, group_ns: int = BATCH_NS
    ) -> int:
        """Return the simulated time, ns, up to which steps are due now.

        Steps are usually made in groups. A camera exposure, however, must not wait for the end of
        its group.

        Args:
            time_ns: simulated time reached so far, ns.
            event_ns: simulated time of the next exposure, ns. The step that contains this time is
                due as soon as the time is reached; None if there is no exposure.
            group_ns: simulated time of a group of steps, ns.
        """
        self._measure_factor(time_ns)
        if self.factor <= 0.0:
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
        """Return the wall time, s, until the next steps are due; negative if they are overdue.

        The arguments are those of `find_due_time`.
        """
        if self.factor <= 0.0:
            return 0.0
        next_ns = (time_ns // group_ns + 1) * group_ns
        if event_ns is not None and event_ns > time_ns:
            next_ns = min(next_ns, event_ns)
        return (next_ns - self._compute_target()) / 1e9 / self.factor

    def _measure_factor(self, time_ns: int) -> None:
        """Measure the real-time factor if WINDOW is over; log a warning if it is too low."""
        now = self._clock()
        elapsed = now - self._window_wall
        if elapsed < WINDOW:
            return
        self.real_time_factor = (time_ns - self._window_ns) / 1e9 / elapsed
        self._window_wall, self._window_ns = now, time_ns
        is_slow = self.real_time_factor < WARN_BELOW * self.factor
        if is_slow and now - self._last_warning >= WARN_PERIOD:
            self._last_warning = now
            log.warning(
                "the simulation is too slow: its real-time factor is %.2f instead of %g; free the "
                "processor, lower the rate or size of the cameras, or set speed_mode to max",
                self.real_time_factor,
                self.factor,
            )

    def _compute_target(self) -> int:
        elapsed = self._clock() - self._wall
        return self._start_ns + round(elapsed * 1e9 * self.factor)
