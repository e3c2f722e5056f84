"""Clock of a recording, which shows resets and messages that are stamped by another clock."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable
from typing import Any

# largest decrease of the time that is not a reset of the clock, ns
RESET_TOLERANCE_NS = 500_000_000
# Largest distance of a message's stamp from /clock when it is recorded, ns: ten times the distance
# at which the controller recognises another clock, because images are compressed before they are
# recorded, and simulated time can run several times as fast as wall time.
CLOCK_TOLERANCE_NS = 5_000_000_000
# The same from the stamps of the controller's states, if the bag has no /clock: the controller can
# start long after the robot.
STATES_TOLERANCE_NS = 3600_000_000_000


class RecordedClock:
    """Time that a clock shows at each position in a bag.

    Attributes:
        resets: positions of the first message after each reset of the clock, in ascending order.
    """

    def __init__(self, entries: Iterable[tuple[Any, int]], tolerance_ns: int) -> None:
        """Create the clock.

        Args:
            entries: pairs of the position of a message and the time that it shows, ns. Time 0 means
                that the clock was not known yet.
            tolerance_ns: largest distance of a stamp of this clock from the time shown at the
                position of its message, ns.
        """
        known = sorted(entry for entry in entries if entry[1])
        self._positions, self._times = [p for p, _ in known], [t for _, t in known]
        self._tolerance_ns = tolerance_ns
        indices = [
            i for i in range(1, len(known))
            if self._times[i] < self._times[i - 1] - RESET_TOLERANCE_NS
        ]  # fmt: skip
        self.resets = [self._positions[i] for i in indices]
        # A message that was sent before a reset can arrive after it.
        self._reset_times = [self._times[i - 1] for i in indices]

    def __bool__(self) -> bool:
        """Return whether the clock shows any time."""
        return bool(self._times)

    def find_difference(self, position: Any, stamp: int) -> int:
        """Return the distance of a stamp from this clock, ns; 0 if the stamp can be of this clock.

        Args:
            position: position of the stamped message.
            stamp: its stamp, ns; 0 if its publisher did not know the time yet.
        """
        if not stamp or not self:
            return 0
        shown = self._times[max(bisect_right(self._positions, position) - 1, 0)]
        distance = min(abs(stamp - time) for time in (shown, *self._reset_times))
        return distance if distance > self._tolerance_ns else 0
