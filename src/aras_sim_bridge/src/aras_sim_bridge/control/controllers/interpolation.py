"""Set points that move every cycle where commands come at 30 or 100 a second.

A stiff joint with little damping rings at every step of its set point: the ARAS arm's J5 (p 3500,
d 0) peaks at 41 times the commanded speed at 30 commands a second, at 12 times at 100.
"""

from math import inf, isnan, nan, pi

import numpy as np

from aras_sim_bridge.angles import angular_distance_within_limits
from aras_sim_bridge.control.joints import JointHandle
from aras_visual_servo_base.compiled import column, jit

USUAL_INTERVAL = 1.0 / 30.0  # s, until a stream tells its own: the camera's
SHORTEST_INTERVAL, LONGEST_INTERVAL = 0.002, 0.1  # s; a longer one is a pause
# A share of the newest interval in the mean one: a command that is 1 ms late or early at 100 a
# second costs J5 a peak of 1.3 times the commanded speed, 1.6 times with a share of 1.
NEWEST_SHARE = 0.2
# s, time constant of the lag that rounds the corners of the line: J5, whose period is 6 ms, peaks
# at 1.05 times the commanded speed with it, at 1.55 without; J3 at 1.3 and 1.4.
LAG_TIME = 0.003
# A line lasts longer than the mean interval by so many times the mean change from one interval to
# the next (half an interval at most: more is a pause), so that it has not ended when a command is
# late: with arrivals up to 2 ms early or late at 100 a second J3's peak stays under 1.5 times the
# commanded speed, 1.7 without. A steady stream is not delayed by it, from its second interval on.
JITTER_FACTOR = 2.2
ARRIVAL_TOLERANCE = 1e-9  # rad or m

# Columns of a row: whether the set point moves, s left of the line, where that is, the set point,
# the line's end and rate; mean interval and its mean change, the latest interval (NaN: none yet),
# s, and arrival (NaN: none), ns; the joint's greatest speed, whether it turns, and its limits.
(
    (
        IS_MOVING,
        _TIME_LEFT,
        _LINE,
        _VALUE,
        _END,
        _RATE,
        _INTERVAL,
        _JITTER,
        _LAST_INTERVAL,
        _ARRIVAL,
        _FASTEST,
        _IS_ANGULAR,
        _LOWER,
        _UPPER,
    ),
    INTERPOLATION_COLUMNS,
) = range(14), 14


class CommandInterpolator:
    """Reaches each command on a straight line over the mean interval between commands, and a little
    more where they come unevenly.

    The line, its corners rounded by a first-order lag, takes longer where it would be faster than
    the joint's velocity limit, and goes the short way round where joint and limits allow, as steps
    do. The set point
    lags a steady stream by one interval and 3 ms, a mean half interval more than steps do. (What
    extrapolates instead rings: over one interval on from the command like the steps themselves,
    half an interval ahead of it at 2.5 times the commanded speed.)
    """

    __slots__ = ("row",)

    is_moving, value = column(IS_MOVING), column(_VALUE)

    def __init__(self, handle: JointHandle, row: np.ndarray | None = None) -> None:
        """`row`: (14,) of a loop's; None: one of its own."""
        self.row = np.zeros(INTERPOLATION_COLUMNS) if row is None else row
        limit = handle.limits.velocity if handle.limits is not None else None
        self.row[_FASTEST:] = (
            limit or inf,
            handle.is_angular,
            *(handle.position_limits or (-inf, inf)),
        )
        self.start(0.0)

    def start(self, position: float) -> None:
        """Rest at `position` and forget the stream before."""
        self.row[: _RATE + 1] = 0.0, 0.0, position, position, position, 0.0
        self.row[_INTERVAL : _ARRIVAL + 1] = USUAL_INTERVAL, 0.0, nan, nan

    def set_target(self, command: float, time_ns: int) -> None:
        """Head for a command that arrived at `time_ns` of the simulated clock."""
        set_interpolation_target(self.row, command, time_ns)

    def advance(self, period: float) -> float:
        """The set point `period` s after the last one; to be asked for while `moves`."""
        return advance_interpolation(self.row, period)


@jit("f8[::1], f8, f8", allocates=False)
def set_interpolation_target(row, command, time_ns):
    """See Interpolation.take."""
    if not isnan(row[_ARRIVAL]):
        interval = (time_ns - row[_ARRIVAL]) / 1e9
        # Pauses, and a clock that was set back, say nothing about the stream.
        if 0.0 < interval <= LONGEST_INTERVAL:
            interval = max(interval, SHORTEST_INTERVAL)
            row[_INTERVAL] += NEWEST_SHARE * (interval - row[_INTERVAL])
            if not isnan(row[_LAST_INTERVAL]):
                shorter = min(interval, row[_LAST_INTERVAL])
                change = min(abs(interval - row[_LAST_INTERVAL]), 0.5 * shorter)
                row[_JITTER] += NEWEST_SHARE * (change - row[_JITTER])
            row[_LAST_INTERVAL] = interval
    row[_ARRIVAL] = time_ns
    distance = command - row[_LINE]
    if row[_IS_ANGULAR] != 0.0 and not -pi < distance < pi:
        distance = angular_distance_within_limits(row[_LINE], command, row[_LOWER], row[_UPPER])
        command = row[_LINE] + distance
    lasting = row[_INTERVAL] + JITTER_FACTOR * row[_JITTER]
    row[_END], row[_TIME_LEFT] = command, max(lasting, abs(distance) / row[_FASTEST])
    row[_RATE], row[IS_MOVING] = distance / row[_TIME_LEFT], 1.0


@jit("f8[::1], f8", allocates=False)
def advance_interpolation(row, period):
    """See Interpolation.advance."""
    row[_TIME_LEFT] -= period
    value = row[_VALUE]
    if row[_TIME_LEFT] > 0.0:
        row[_LINE] += row[_RATE] * period
    else:
        row[_LINE] = row[_END]
        if -ARRIVAL_TOLERANCE < row[_LINE] - value < ARRIVAL_TOLERANCE:
            row[IS_MOVING], row[_VALUE] = 0.0, row[_LINE]
            return row[_LINE]
    value += (row[_LINE] - value) * period / (LAG_TIME + period)
    row[_VALUE] = value
    return value
