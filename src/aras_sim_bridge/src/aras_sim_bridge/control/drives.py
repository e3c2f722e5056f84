"""Drives, which apply the commands of the joints to the simulated model.

`compute_outputs` is called in every physics step. If a command is not finite, a drive uses the last
finite command.
"""

import logging
from collections.abc import Sequence
from math import inf, isfinite, isnan, nan
from typing import Protocol

import numpy as np

from aras_sim_bridge.angles import angular_distance_within_limits, shortest_angular_distance
from aras_sim_bridge.control.joints import (
    COMMAND_COLUMNS,
    COMMAND_ROUNDING,
    EFFORT,
    EVENT_COLUMNS,
    POSITION,
    Q_COMMAND,
    VELOCITY,
    JointBounds,
    JointHandle,
    Q,
    RateLimitedEvent,
    V,
    record_event,
)
from aras_sim_bridge.control.limits import (
    NO_RULE,
    RULE_COLUMNS,
    enforce_limits,
    make_rule,
)
from aras_sim_bridge.control.pid import PID_COLUMNS, Pid, compute_pid
from aras_visual_servo_base.compiled import jit

log = logging.getLogger(__name__)

# Kinds of drives:
DRIVES_EFFORT = 0  # a drive that applies the commanded effort
SETS_POSITION = 1  # a drive that sets the joint's position to the commanded position
POSITION_BY_PID = 2  # a drive that applies the effort of a PID for the position error
TURNS_MOTOR = 3  # a drive that makes a motor constraint of Bullet keep the commanded velocity
VELOCITY_BY_PID = 4  # a drive that applies the effort of a PID for the velocity error
# For each command interface, the kind of drive without PID gains, and the kind with PID gains.
_KINDS = {
    EFFORT: (DRIVES_EFFORT, DRIVES_EFFORT),
    POSITION: (SETS_POSITION, POSITION_BY_PID),
    VELOCITY: (TURNS_MOTOR, VELOCITY_BY_PID),
}
_QUANTITIES = {EFFORT: "effort", POSITION: "position", VELOCITY: "velocity"}
# For each command interface, the time for which a command must exceed a limit before a warning is
# logged, s. Efforts and velocities exceed their limits briefly in each step response.
_PATIENCE = {EFFORT: 0.25, POSITION: 0.0, VELOCITY: 0.25}
# Ways to compute the position error of a drive:
_PLAIN = 0  # difference of the positions
_SHORTEST = 1  # shortest rotation to the commanded angle
_WITHIN = 2  # shortest rotation to the commanded angle that stays within the position limits

# Columns of the array that stores the state of a Drive. The first columns belong to its Pid, the
# next ones to its LimitRule; a drive without a Pid or LimitRule does not use them.
_RULE = PID_COLUMNS
(
    JOINT,  # index of the driven joint in the model
    _COMMAND,  # column of the JointHandle's row that contains the command
    KIND,  # kind of the drive, such as DRIVES_EFFORT
    MAX_EFFORT,  # largest effort that the drive's PID may apply, N m or N
    # speed of the joint above which the drive's PID does not accelerate it, rad/s or m/s
    _MAX_VELOCITY,
    _LOWER,  # lower position limit of the joint, rad or m
    _UPPER,  # upper position limit of the joint, rad or m
    _ERROR_KIND,  # kind of the position error: _PLAIN, _SHORTEST or _WITHIN
    # position that the joint holds during an emergency stop, rad or m; NaN without a stop
    _STOP_POSITION,
    _LAST_VALID,  # last command that was finite, in the unit of the command interface
    OUTPUT,
) = range(_RULE + RULE_COLUMNS, _RULE + RULE_COLUMNS + 11)
# Further columns, for the warnings of a Drive. _WARNINGS is 1 for a command that is not finite, 2
# for one beyond a limit, and 3 for both. The next three columns are values for the messages. The
# last columns belong to two RateLimitedEvents.
(_WARNINGS, _INVALID_COMMAND, _DESIRED, _APPLIED, _LIMIT_EVENT) = range(OUTPUT + 1, OUTPUT + 6)
_INVALID_EVENT = _LIMIT_EVENT + EVENT_COLUMNS
DRIVE_COLUMNS = _INVALID_EVENT + EVENT_COLUMNS


class SimulatedRobot(Protocol):
    """Methods of a simulated robot that RobotHardware uses; efforts are in N m or N."""

    joint_names: tuple[str, ...]

    def read_joints(self) -> tuple[Sequence[float], Sequence[float], Sequence[float]]:
        """Return positions, velocities and last applied efforts, in joint_names order."""

    def apply_effort(self, joint: str, effort: float) -> None:
        """Apply an effort during the next physics step."""

    def set_position(self, joint: str, position: float) -> float:
        """Set the joint's position without dynamics, limited to its stops; return this position."""

    def set_velocity_motor(self, joint: str, velocity: float, max_effort: float) -> None:
        """Drive the joint at a velocity, with at most this effort."""

    def bound_speed(self, joint: str, fastest: float) -> None:
        """Limit the joint's speed to `fastest`, rad/s or m/s, whatever effort acts on it."""


class Drive:
    """Drive of one joint, which limits the joint's command and applies it; `row` stores the state.
    """

    def __init__(
        self,
        row: np.ndarray,
        handle: JointHandle,
        limits: JointBounds | None,
        joint: int,
        pid: Pid | None = None,
    ) -> None:
        """Create a drive whose state is stored in `row`; `joint` is the joint's index in the model.

        Raises:
            HardwareError: the joint lacks a limit, such as max_velocity, that its LimitRule needs.
        """
        self.row, self.handle, self.pid = row, handle, pid
        interface = handle.interface
        self.kind = _KINDS[interface][pid is not None]
        self.rule = make_rule(handle, limits, row[_RULE : _RULE + RULE_COLUMNS])
        if pid is not None:
            pid.bind(row[:PID_COLUMNS])
        limits = limits or JointBounds()
        row[JOINT], row[_COMMAND], row[KIND] = joint, COMMAND_COLUMNS[interface], self.kind
        row[MAX_EFFORT] = inf if limits.max_effort is None else limits.max_effort
        row[_MAX_VELOCITY] = inf if limits.max_velocity is None else limits.max_velocity
        row[_LOWER], row[_UPPER] = -inf, inf
        row[_ERROR_KIND] = _SHORTEST if handle.is_angular else _PLAIN
        if limits.has_position:
            row[_LOWER], row[_UPPER] = limits.min_position, limits.max_position
            if handle.kind == "revolute":
                row[_ERROR_KIND] = _WITHIN
        self._limit_event = RateLimitedEvent(
            _PATIENCE[interface], row=row[_LIMIT_EVENT:_INVALID_EVENT]
        )
        self._invalid_event = RateLimitedEvent(row=row[_INVALID_EVENT:])

    def start(self) -> None:
        """Reset the drive; the joint holds its position until it receives a command."""
        handle, row = self.handle, self.row
        handle.position_command = handle.position
        handle.velocity_command = handle.effort_command = 0.0
        row[_LAST_VALID] = handle.position if handle.interface == POSITION else 0.0
        row[_STOP_POSITION] = nan
        self._limit_event.reset()
        self._invalid_event.reset()
        if self.rule is not None:
            self.rule.reset()
        if self.pid is not None:
            self.pid.reset()

    def apply(self, model: SimulatedRobot, time_ns: int) -> None:
        """Apply the output to the model."""
        name, output = self.handle.name, self.row.item(OUTPUT)
        if self.kind == SETS_POSITION:
            reached = model.set_position(name, output)
            if abs(reached - output) > COMMAND_ROUNDING and self._limit_event.record(time_ns):
                log.warning(
                    f"joint '{name}': position command {output:g} is beyond the joint's stop at "
                    f"{reached:g}; the joint stays at this stop; change the command or joint_limits"
                )
        elif self.kind == TURNS_MOTOR:
            model.set_velocity_motor(name, output, self.row.item(MAX_EFFORT))
        else:
            model.apply_effort(name, output)

    def log_warnings(self) -> None:
        """Log the warnings of `compute_outputs`, once for each event."""
        row, handle = self.row, self.handle
        news, row[_WARNINGS] = int(row[_WARNINGS]), 0.0
        what = f"joint '{handle.name}': {_QUANTITIES[handle.interface]} command"
        if news & 1:
            log.warning(
                f"{what} {row[_INVALID_COMMAND]} is not finite; {row[_LAST_VALID]:g} stays in use. "
                "Check the controller that commands it"
            )
        if news & 2:
            log.warning(
                f"{what} {row[_DESIRED]:g} exceeds the limits that apply at position "
                f"{handle.position:g} and velocity {handle.velocity:g}; {row[_APPLIED]:g} is "
                "applied; change the command or the limits"
            )


@jit("f8[::1], f8[::1], f8, f8, b1", allocates=False)
def _limit_command(row, handle, time_ns, dt, stopped):
    """Return a drive's limited command; the last finite command replaces inf and NaN."""
    column = int(row[_COMMAND])
    if column == Q_COMMAND:
        if not stopped:
            row[_STOP_POSITION] = nan
        elif isnan(row[_STOP_POSITION]):
            row[_STOP_POSITION] = handle[Q]
        if stopped:
            handle[column] = row[_STOP_POSITION]
    desired = handle[column]
    if not isfinite(desired):
        if record_event(row[_INVALID_EVENT:], time_ns):
            row[_WARNINGS], row[_INVALID_COMMAND] = row[_WARNINGS] + 1.0, desired
        desired = handle[column] = row[_LAST_VALID]
    rule = row[_RULE : _RULE + RULE_COLUMNS]
    if rule[0] != NO_RULE:
        beyond, given = enforce_limits(rule, handle, dt), handle[column]
        if column == Q_COMMAND:
            # The velocity limit delays most position commands, which is normal. Therefore only a
            # command outside the position limits causes a warning.
            beyond = not row[_LOWER] <= desired <= row[_UPPER]
            given = row[_LOWER] if desired < row[_LOWER] else row[_UPPER]
        beyond = beyond and abs(desired - given) > COMMAND_ROUNDING
        if beyond and record_event(row[_LIMIT_EVENT:_INVALID_EVENT], time_ns):
            row[_WARNINGS], row[_DESIRED], row[_APPLIED] = row[_WARNINGS] + 2.0, desired, given
    row[_LAST_VALID] = handle[column]
    return row[_LAST_VALID]


@jit("f8[:,::1], f8[:,::1], f8, f8, b1", allocates=False)
def compute_outputs(rows, handles, time_ns, dt, stopped):
    """Compute the outputs of drives from the commands in `handles` (m, 6).

    Args:
        dt: time since the last call, s.
        stopped: whether the emergency stop is active; then efforts and velocities are 0 and
            positions are constant.

    Returns:
        Whether there are warnings for Drive.log_warnings.
    """
    news = False
    for k in range(len(rows)):
        row, handle = rows[k], handles[k]
        kind = int(row[KIND])
        output = _limit_command(row, handle, time_ns, dt, stopped)
        if kind == POSITION_BY_PID:
            if row[_ERROR_KIND] == _WITHIN:
                error = angular_distance_within_limits(handle[Q], output, row[_LOWER], row[_UPPER])
            elif row[_ERROR_KIND] == _SHORTEST:
                error = shortest_angular_distance(handle[Q], output)
            else:
                error = output - handle[Q]
        elif stopped and kind != SETS_POSITION:
            output = 0.0
        if kind == VELOCITY_BY_PID:
            error = output - handle[V]
        if kind in (POSITION_BY_PID, VELOCITY_BY_PID):
            output = compute_pid(row[:PID_COLUMNS], error, 0.0, False, dt)
            # Limit the effort. If the joint exceeds its velocity limit, the effort may only slow
            # the joint down.
            low = 0.0 if handle[V] < -row[_MAX_VELOCITY] else -row[MAX_EFFORT]
            high = 0.0 if handle[V] > row[_MAX_VELOCITY] else row[MAX_EFFORT]
            output = low if output < low else high if output > high else output
        row[OUTPUT] = output
        news |= row[_WARNINGS] != 0.0
    return news
