"""Interpolation of set points between commands that arrive at 30 or 100 Hz.

Each step of the set point makes a stiff joint with little damping oscillate. Without
interpolation, the speed of joint J5 of the ARAS arm (gains p = 3500, d = 0) reaches 41 times the
commanded speed at 30 commands per second, and 12 times at 100 commands per second.
"""

from math import inf, isnan, nan, pi

import numpy as np

from aras_sim_bridge.angles import angular_distance_within_limits
from aras_sim_bridge.control.joints import JointHandle
from aras_visual_servo_base.compiled import column, jit

# Interval between commands, s, that is assumed until two commands have arrived: the period of a
# 30 Hz camera.
USUAL_INTERVAL = 1.0 / 30.0
SHORTEST_INTERVAL = 0.002  # s; a shorter interval enters the mean interval with this value
LONGEST_INTERVAL = 0.1  # s; a longer interval is a pause and does not enter the mean interval
# Weight of the newest interval in the mean interval between commands. If one command of a 100 Hz
# stream arrives 1 ms early or late, joint J5 reaches 1.3 times the commanded speed. With a weight
# of 1, it would reach 1.6 times.
NEWEST_SHARE = 0.2
# Time constant, s, of the first-order lag that smooths the speed steps between successive lines.
# The lag reduces the largest speed of J5, which oscillates with a period of 6 ms, from 1.55 to 1.05
# times the commanded speed, and that of J3 from 1.4 to 1.3 times.
LAG_TIME = 0.003
# The set point takes longer than the mean interval to reach a command, so that it still moves when
# the next command is late. The additional time is this factor times the mean change from one
# interval to the next. Changes are limited to half an interval, because longer changes are pauses.
# If commands at 100 Hz arrive up to 2 ms early or late, J3 reaches less than 1.5 times the
# commanded speed; without the additional time, it reaches 1.7 times. In a regular stream, the
# additional time is zero from the second interval on.
JITTER_FACTOR = 2.2
# Distance, rad or m, at which the set point is moved to the command and stops.
ARRIVAL_TOLERANCE = 1e-9

# Columns of an interpolator's row.
(
    (
        IS_MOVING,  # whether the set point moves
        _TIME_LEFT,  # s, time until the end of the line is reached
        _LINE,  # current position on the line, without the lag
        _VALUE,  # set point
        _END,  # end of the line, which is the last command
        _RATE,  # velocity along the line
        _INTERVAL,  # s, mean interval between commands
        _JITTER,  # s, mean change from one interval to the next
        _LAST_INTERVAL,  # s; NaN before the second command
        _ARRIVAL,  # ns, arrival of the last command; NaN before the first command
        _FASTEST,  # velocity limit of the joint
        _IS_ANGULAR,  # whether the joint is angular
        _LOWER,  # lower position limit
        _UPPER,  # upper position limit
    ),
    INTERPOLATION_COLUMNS,
) = range(14), 14


class CommandInterpolator:
    """Set point that approaches each command on a straight line over the mean command interval.

    The line takes longer if commands arrive irregularly or if the joint would exceed its velocity
    limit. A first-order lag smooths the change from one line to the next. An angular joint rotates
    in the shorter direction that its limits allow.

    If commands arrive regularly, the set point lags them by one interval and 3 ms. On average, this
    is half an interval more than without interpolation. Extrapolating the commands would reduce the
    lag but make the joint oscillate: if extrapolated over a full interval, as much as without
    interpolation; over half an interval, with up to 2.5 times the commanded speed.
    """

    __slots__ = ("row",)

    is_moving, value = column(IS_MOVING), column(_VALUE)

    def __init__(self, handle: JointHandle, row: np.ndarray | None = None) -> None:
        """Store the state in `row` (14,), a slice of a JointLoop's row, or in a new array."""
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
    """Start a line in an interpolator's row towards a command that arrived at `time_ns`."""
    if not isnan(row[_ARRIVAL]):
        interval = (time_ns - row[_ARRIVAL]) / 1e9
        # A time that contains a pause or a reset of the clock does not enter the mean interval.
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
    """Advance the set point in an interpolator's row by `period` s, and return it."""
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
