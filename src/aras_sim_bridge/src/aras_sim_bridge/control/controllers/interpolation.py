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

# Interval between commands that is assumed until two commands have arrived, s: the period of a 30
# Hz camera.
USUAL_INTERVAL = 1.0 / 30.0
# Shortest interval between commands, s. A shorter interval counts as this one in the mean interval.
SHORTEST_INTERVAL = 0.002
# Longest interval between commands, s. A longer interval is a pause and is left out of the mean
# interval.
LONGEST_INTERVAL = 0.1
# Weight of the newest interval in the running mean of the interval between commands. If one command
# of a 100 Hz stream arrives 1 ms early or late, joint J5 of the ARAS arm reaches 1.3 times the
# commanded speed. With a weight of 1, J5 would reach 1.6 times.
NEWEST_SHARE = 0.2
# Time constant of the first-order lag that smooths the change of speed at each command, s. On the
# ARAS arm, it reduces the largest speed of joint J5 from 1.55 to 1.05 times the commanded speed,
# and that of J3 from 1.4 to 1.3 times.
LAG_TIME = 0.003
# If commands arrive irregularly, the set point takes longer than the mean interval to reach a
# command, so that it still moves when the next command is late. The additional time is this factor
# times the mean absolute difference of successive intervals. With commands at 100 Hz that arrive up
# to 2 ms early or late, joint J3 of the ARAS arm reaches less than 1.5 times the commanded speed;
# without the additional time, it reaches 1.7 times.
JITTER_FACTOR = 2.2
# Distance from the set point to the command at which the set point jumps to the command and stops,
# rad or m.
ARRIVAL_TOLERANCE = 1e-9

# Columns of the array that stores the state of a CommandInterpolator.
(
    (
        IS_MOVING,  # whether the set point is moving
        _TIME_LEFT,  # time until the set point's straight line reaches the last command, s
        _LINE,  # position on the straight line to the last command, rad or m
        _VALUE,  # set point: the position on the straight line after the first-order lag, rad or m
        _END,  # end of the straight line: the last command, rad or m
        _RATE,  # velocity along the straight line to the last command, rad/s or m/s
        _INTERVAL,  # running mean of the interval between commands, s
        _JITTER,  # running mean of the change from one interval between commands to the next, s
        _LAST_INTERVAL,  # last interval between two commands, s; NaN before the second command
        _ARRIVAL,  # arrival time of the last command, ns; NaN before the first command
        _FASTEST,  # velocity limit of the joint, rad/s or m/s
        _IS_ANGULAR,  # whether the joint is revolute or continuous
        _LOWER,  # lower position limit of the joint, rad or m
        _UPPER,  # upper position limit of the joint, rad or m
    ),
    INTERPOLATION_COLUMNS,
) = range(14), 14


class CommandInterpolator:
    """Set point that approaches each command on a straight line over the mean command interval.

    The line takes longer if commands arrive irregularly or if the joint would exceed its velocity
    limit. A first-order lag smooths the change from one line to the next. An angular joint rotates
    in the shorter direction that its limits allow.

    If commands arrive regularly, the set point lags them by one interval and 3 ms. Extrapolating
    the commands would reduce this lag, but the joint would oscillate at up to 2.5 times the
    commanded speed or more.

    Compiled code calls `set_interpolation_target` for each command and, while row[IS_MOVING] is
    not 0, `advance_interpolation` in each cycle.
    """

    value = column(_VALUE)

    def __init__(self, handle: JointHandle, row: np.ndarray | None = None) -> None:
        """Store the state in `row` (14,), part of a JointControlLoop's row; None: a new array."""
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


@jit("f8[::1], f8, f8", allocates=False)
def set_interpolation_target(row, command, time_ns):
    """Start an interpolator's straight line to a command that arrived at `time_ns`."""
    if not isnan(row[_ARRIVAL]):
        interval = (time_ns - row[_ARRIVAL]) / 1e9
        # Leave out an interval that contains a pause of the commands or a reset of the clock.
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
    """Advance an interpolator by `period` s, and return its set point."""
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
