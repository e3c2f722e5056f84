"""Clock of a recording; it finds resets and messages that were stamped with another clock."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable
from typing import Any

# largest decrease of the time that is not a reset of the clock, ns
RESET_TOLERANCE_NS = 500_000_000
# Largest difference between a message's stamp and the time of /clock at which it is recorded, ns.
# It is ten times the difference at which the controller detects another clock, because images are
# compressed before they are recorded, and simulated time can run several times as fast as wall
# time.
CLOCK_TOLERANCE_NS = 5_000_000_000
# Tolerance that replaces CLOCK_TOLERANCE_NS if the bag has no /clock and the stamps of the
# controller's states serve as the clock, ns. It is large, because the controller can start long
# after the robot.
STATES_TOLERANCE_NS = 3600_000_000_000


class RecordedClock:
    """Time of a recorded clock at each position in a bag, by the messages that show this time.

    Attributes:
        resets: positions of the first message after each reset of the clock, in ascending order.
    """

    def __init__(self, entries: Iterable[tuple[Any, int]], tolerance_ns: int) -> None:
        """Create the clock.

        Args:
            entries: pairs of the position of a message in the bag and the time that this message
                shows, ns. Time 0 means that the time was not known yet.
            tolerance_ns: largest difference between the stamp of a message and the time of the
                clock at the position of this message, ns. A larger difference means that the stamp
                is from another clock.
        """
        known = sorted(entry for entry in entries if entry[1])
        self._positions, self._times = [p for p, _ in known], [t for _, t in known]
        self._tolerance_ns = tolerance_ns
        indices = [
            i for i in range(1, len(known))
            if self._times[i] < self._times[i - 1] - RESET_TOLERANCE_NS
        ]  # fmt: skip
        self.resets = [self._positions[i] for i in indices]
        # A message that was sent before a reset can arrive after it. Therefore the last time before
        # each reset is stored, too.
        self._reset_times = [self._times[i - 1] for i in indices]

    def __bool__(self) -> bool:
        """Return whether any time of the clock is known."""
        return bool(self._times)

    def find_difference(self, position: Any, stamp: int) -> int:
        """Return the difference of a message's stamp from this clock, ns; 0 within the tolerance.

        Args:
            position: position of the message in the bag.
            stamp: stamp of the message, ns; 0 if its publisher did not know the time yet.
        """
        if not stamp or not self:
            return 0
        shown = self._times[max(bisect_right(self._positions, position) - 1, 0)]
        distance = min(abs(stamp - time) for time in (shown, *self._reset_times))
        return distance if distance > self._tolerance_ns else 0
