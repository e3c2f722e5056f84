"""Set points that move every cycle where commands come at 30 or 100 a second.

A stiff joint with little damping rings at every step of its set point: the ARAS arm's J5 (p 3500,
d 0) peaks at 41 times the commanded speed at 30 commands a second, at 12 times at 100.
"""

from math import inf, pi

from aras_sim_bridge import angles
from aras_sim_bridge.control.joints import JointHandle

USUAL_INTERVAL = 1.0 / 30.0  # s, until a stream tells its own: the camera's
SHORTEST_INTERVAL, LONGEST_INTERVAL = 0.002, 0.1  # s; a longer one is a pause
# A share of the newest interval in the mean one: a command that is 1 ms late or early at 100 a
# second costs J5 a peak of 1.3 times the commanded speed, 1.6 times with a share of 1.
NEWEST = 0.2
# s, time constant of the lag that rounds the corners of the line: J5, whose period is 6 ms, peaks
# at 1.05 times the commanded speed with it, at 1.55 without; J3 at 1.3 and 1.4.
ROUNDING = 0.003
# A line lasts longer than the mean interval by so many times the mean change from one interval to
# the next (half an interval at most: more is a pause), so that it has not ended when a command is
# late: with arrivals up to 2 ms early or late at 100 a second J3's peak stays under 1.5 times the
# commanded speed, 1.7 without. A steady stream is not delayed by it, from its second interval on.
CHANGES = 2.2
ARRIVED = 1e-9  # rad or m


class Interpolation:
    """Reaches each command on a straight line over the mean interval between commands, and a little
    more where they come unevenly.

    The line, its corners rounded by a first-order lag, takes longer where it would be faster than
    the joint's velocity limit, and goes the short way round where joint and limits allow, as steps
    do. The set point
    lags a steady stream by one interval and 3 ms, a mean half interval more than steps do. (What
    extrapolates instead rings: over one interval on from the command like the steps themselves,
    half an interval ahead of it at 2.5 times the commanded speed.)
    """

    __slots__ = ("value", "moves", "_command", "_line", "_rate", "_left", "_interval",
                 "_change", "_latest", "_arrival_ns", "_max_velocity", "_wraps", "_travel")

    def __init__(self, handle: JointHandle) -> None:
        limit = handle.limits.velocity if handle.limits is not None else None
        self._max_velocity = limit if limit else inf
        self._wraps = handle.kind in ("revolute", "continuous")
        self._travel = handle.travel or (-inf, inf)
        self.start(0.0)

    def start(self, position: float) -> None:
        """Rest at `position` and forget the stream before."""
        self.value = self._command = self._line = position
        self._rate = self._left = 0.0
        self.moves = False
        self._interval = USUAL_INTERVAL
        self._change = 0.0
        self._latest: float | None = None
        self._arrival_ns: int | None = None

    def take(self, command: float, time_ns: int) -> None:
        """Head for a command that arrived at `time_ns` of the simulated clock."""
        if self._arrival_ns is not None:
            interval = (time_ns - self._arrival_ns) / 1e9
            # Pauses, and a clock that was set back, say nothing about the stream.
            if 0.0 < interval <= LONGEST_INTERVAL:
                interval = max(interval, SHORTEST_INTERVAL)
                self._interval += NEWEST * (interval - self._interval)
                if self._latest is not None:
                    shorter = min(interval, self._latest)
                    change = min(abs(interval - self._latest), 0.5 * shorter)
                    self._change += NEWEST * (change - self._change)
                self._latest = interval
        self._arrival_ns = time_ns
        distance = command - self._line
        if self._wraps and not -pi < distance < pi:
            distance = angles.towards(self._line, command, *self._travel)
            command = self._line + distance
        self._command = command
        lasting = self._interval + CHANGES * self._change
        self._left = max(lasting, abs(distance) / self._max_velocity)
        self._rate = distance / self._left
        self.moves = True

    def advance(self, period: float) -> float:
        """The set point `period` s after the last one; to be asked for while `moves`."""
        left = self._left = self._left - period
        value = self.value
        if left > 0.0:
            line = self._line = self._line + self._rate * period
        else:
            line = self._line = self._command
            if -ARRIVED < line - value < ARRIVED:
                self.moves = False
                self.value = line
                return line
        self.value = value = value + (line - value) * period / (ROUNDING + period)
        return value

    def on_the_way(self) -> tuple[float, ...]:
        """Whether it moves, time left, line, value, command and rate: what `advance` goes by."""
        return self.moves, self._left, self._line, self.value, self._command, self._rate

    def go_on(self, moves: float, left: float, line: float, value: float) -> None:
        """Be where so many calls of `advance` would have brought it."""
        self.moves, self._left, self._line, self.value = moves != 0.0, left, line, value
