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


class RealTimeFactorMeter:
    """Meter of the real-time factor (simulated time over wall time); warns if it is too low."""

    def __init__(self, clock: Callable[[], float]) -> None:
        """Create a meter; `clock` returns the wall time, s."""
        self.value = 0.0
        self._clock = clock
        self._last_warning = -WARN_PERIOD
        self.restart(0)

    def restart(self, time_ns: int) -> None:
        """Start a new measurement window at the simulated time `time_ns`."""
        self._wall = self._clock()
        self._time_ns = time_ns

    def update(self, time_ns: int, desired: float) -> None:
        """Update the measured factor; `time_ns` is the simulated time reached so far.

        A warning is logged if the factor is too far below `desired`; 0 disables the warning.
        """
        now = self._clock()
        elapsed = now - self._wall
        if elapsed < WINDOW:
            return
        self.value = (time_ns - self._time_ns) / 1e9 / elapsed
        self.restart(time_ns)
        if self.value < WARN_BELOW * desired and now - self._last_warning >= WARN_PERIOD:
            self._last_warning = now
            log.warning(
                "the simulation is too slow: its real-time factor is %.2f instead of %g; free the "
                "processor, lower the rate or size of the cameras, or set speed_mode to max",
                self.value,
                desired,
            )


class Pacer:
    """Pacer that advances simulated time `factor` times as fast as wall time.

    A factor of 0 means as fast as possible. The time at which a step is due is computed from the
    wall time since the last call of `restart`, so that rounding errors and late wake-ups do not
    accumulate.

    Attributes:
        factor: desired real-time factor; 0 means as fast as possible. Call `set_factor` to change
            it.
    """

    def __init__(self, factor: float = 1.0, clock: Callable[[], float] = time.monotonic) -> None:
        """Create a pacer; `clock` returns the wall time, s."""
        self.factor = factor
        self._clock = clock
        self._meter = RealTimeFactorMeter(clock)
        self.restart(0)

    @property
    def real_time_factor(self) -> float:
        """Real-time factor measured over the last WINDOW seconds."""
        return self._meter.value

    def set_factor(self, factor: float, time_ns: int) -> None:
        """Change the desired factor from the simulated time `time_ns` on."""
        self.factor = factor
        self.restart(time_ns)

    def restart(self, time_ns: int) -> None:
        """Align the simulated time `time_ns` with the current wall time, e.g. after a pause."""
        self._wall = self._clock()
        self._start_ns = time_ns
        self._meter.restart(time_ns)

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
        self._meter.update(time_ns, self.factor)
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

    def _compute_target(self) -> int:
        elapsed = self._clock() - self._wall
        return self._start_ns + round(elapsed * 1e9 * self.factor)
