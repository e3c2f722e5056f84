"""How long the controllers' updates take (controller_manager_msgs/ControllersStatistics)."""

from dataclasses import dataclass
from math import sqrt


@dataclass(frozen=True, slots=True)
class ControllerStatistics:
    """Update times of one controller in s; instants in ns of the simulated clock.

    `variance_time` is the standard deviation: the message's field is a duration, so it cannot
    hold a square.
    """

    name: str
    type: str
    timestamp_ns: int
    running: bool
    max_time: float
    mean_time: float
    variance_time: float
    num_control_loop_overruns: int
    time_last_control_loop_overrun_ns: int


class UpdateTimer:
    """Running mean and spread (Welford) of update times."""

    __slots__ = ("count", "mean", "maximum", "overruns", "last_overrun_ns", "last_ns", "_squares")

    def __init__(self) -> None:
        self.count = 0
        self.mean = 0.0
        self.maximum = 0.0
        self.overruns = 0
        self.last_overrun_ns = 0
        self.last_ns = 0
        self._squares = 0.0

    def add(self, elapsed_ns: int, time_ns: int, period: float) -> None:
        """Take in one update at `time_ns`; longer than `period` (s) is an overrun."""
        elapsed = elapsed_ns / 1e9
        self.count += 1
        self.last_ns = time_ns
        change = elapsed - self.mean
        self.mean += change / self.count
        self._squares += change * (elapsed - self.mean)
        if elapsed > self.maximum:
            self.maximum = elapsed
        if elapsed > period:
            self.overruns += 1
            self.last_overrun_ns = time_ns

    def statistics(self, name: str, type_name: str, running: bool) -> ControllerStatistics:
        """What was measured so far."""
        spread = sqrt(self._squares / self.count) if self.count else 0.0
        return ControllerStatistics(
            name, type_name, self.last_ns, running, self.maximum, self.mean, spread,
            self.overruns, self.last_overrun_ns,
        )
