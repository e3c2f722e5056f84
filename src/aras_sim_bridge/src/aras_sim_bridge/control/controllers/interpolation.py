"""Interpolation of set points between commands that arrive at 30 or 100 Hz.

Each step of the set point excites a stiff joint with little damping: without interpolation the ARAS
arm's J5 (p 3500, d 0) peaks at 41 times the commanded speed with 30 commands per second, and at 12
times with 100.
"""

from math import inf, isnan, nan, pi

import numpy as np

from aras_sim_bridge.angles import angular_distance_within_limits
from aras_sim_bridge.control.joints import JointHandle
from aras_visual_servo_base.compiled import column, jit

USUAL_INTERVAL = 1.0 / 30.0  # s, the camera's period; used until two commands have arrived
SHORTEST_INTERVAL, LONGEST_INTERVAL = 0.002, 0.1  # s; a longer interval is a pause
# Weight of the newest interval in the mean interval. If one command of a 100 Hz stream arrives 1 ms
# early or late, J5 peaks at 1.3 times the commanded speed; with a weight of 1 at 1.6 times.
NEWEST_SHARE = 0.2
# s, time constant of the lag that smooths the corners of the line: J5, whose period is 6 ms, peaks
# at 1.05 times the commanded speed with it and at 1.55 without; J3 at 1.3 and 1.4.
LAG_TIME = 0.003
# A line is longer than the mean interval, so that it has not ended when a command is late. The
# additional time is this factor times the mean change from one interval to the next (limited to
# half an interval, because longer changes are pauses). With arrivals up to 2 ms early or late at
# 100 Hz, J3 peaks below 1.5 times the commanded speed, and at 1.7 without. A steady stream is not
# delayed from its second interval on.
JITTER_FACTOR = 2.2
ARRIVAL_TOLERANCE = 1e-9  # rad or m

# Columns of a row: whether the set point moves; remaining time of the line, s; the line's position;
# the set point; the line's end and rate; mean interval, its mean change and the last interval
# (NaN: none yet), s; last arrival (NaN: none), ns; the joint's velocity limit, whether the joint is
# angular, and its position limits.
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
    """Set point that approaches each command on a straight line over the mean command interval.

    The line is longer if commands arrive irregularly or if it would exceed the joint's velocity
    limit. A first-order lag smooths its corners. An angular joint takes the shortest way that its
    limits allow.

    The set point lags a steady stream by one interval and 3 ms, which is half an interval more, on
    average, than set points that step. Extrapolation instead would excite the joint: over a full
    interval as much as steps do, over half an interval up to 2.5 times the commanded speed.
    """

    __slots__ = ("row",)

    is_moving, value = column(IS_MOVING), column(_VALUE)

    def __init__(self, handle: JointHandle, row: np.ndarray | None = None) -> None:
        """Store the state in `row` (14,), a part of a loop's row; None creates a new row."""
        self.row = np.zeros(INTERPOLATION_COLUMNS) if row is None else row
        limit = handle.limits.velocity if handle.limits is not None else None
        self.row[_FASTEST:] = (
            limit or inf,
            handle.is_angular,
            *(handle.position_limits or (-inf, inf)),
        )
        self.start(0.0)

    def start(self, position: float) -> None:
        """Rest at `position` and discard the statistics of previous commands."""
        self.row[: _RATE + 1] = 0.0, 0.0, position, position, position, 0.0
        self.row[_INTERVAL : _ARRIVAL + 1] = USUAL_INTERVAL, 0.0, nan, nan

    def set_target(self, command: float, time_ns: int) -> None:
        """Move towards a command that arrived at `time_ns` of simulated time."""
        set_interpolation_target(self.row, command, time_ns)

    def advance(self, period: float) -> float:
        """Return the set point `period` s after the last one; call this only while `is_moving`."""
        return advance_interpolation(self.row, period)


@jit("f8[::1], f8, f8", allocates=False)
def set_interpolation_target(row, command, time_ns):
    """Start a line to a command; see CommandInterpolator.set_target."""
    if not isnan(row[_ARRIVAL]):
        interval = (time_ns - row[_ARRIVAL]) / 1e9
        # Pauses, and a clock that was reset, are not intervals of the stream.
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
    """Advance the set point; see CommandInterpolator.advance."""
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
