"""Control loop of one joint of a JointCommandController (see forward.py)."""

import logging
from math import inf

import numpy as np

from aras_sim_bridge.angles import angular_distance_within_limits
from aras_sim_bridge.control.controllers.base import JointControllerState
from aras_sim_bridge.control.controllers.interpolation import (
    INTERPOLATION_COLUMNS,
    IS_MOVING,
    CommandInterpolator,
    advance_interpolation,
    set_interpolation_target,
)
from aras_sim_bridge.control.joints import (
    COMMAND_COLUMNS,
    COMMAND_ROUNDING,
    Q_COMMAND,
    JointHandle,
    Q,
    RateLimitedEvent,
    V,
)
from aras_sim_bridge.control.pid import PID_COLUMNS, Pid, compute_pid
from aras_visual_servo_base.compiled import column, jit

log = logging.getLogger(__name__)

# A position error of an angular joint below this value, rad, is used as it is: the direct rotation
# is then the shorter one, and it stays within the position limits.
LARGEST_PLAIN_DIFFERENCE = 3.14

# Kinds of joint loops:
FORWARD = 0  # the command of the controller is the output of the loop
POSITION_PID = 1  # the command of the controller is the set point of a position PID
SPEED_PID = 2  # the command of the controller is the set point of a velocity PID

# Columns of the array that stores the state of a JointControlLoop, after the columns of its Pid.
(
    _HANDLE,  # index of the joint's handle among the robot's handles
    _TARGET,  # column of the handle's row that receives the output of the loop
    _KIND,  # kind of the loop: FORWARD, POSITION_PID or SPEED_PID
    _IS_ANGULAR,  # whether the joint is revolute or continuous
    _LOWER,  # lower position limit of the joint, rad or m
    _UPPER,  # upper position limit of the joint, rad or m
    _COMMAND,  # last command to the controller
    _SET_POINT,
    _ERROR,
    _OUTPUT,
    _INTERPOLATES,  # whether the set point moves to each command gradually
    _UPDATES,
    _INTERPOLATION,  # first column of the loop's CommandInterpolator
) = range(PID_COLUMNS, PID_COLUMNS + 13)
LOOP_COLUMNS = _INTERPOLATION + INTERPOLATION_COLUMNS


class JointControlLoop:
    """Control loop of one joint; its state is stored in `row`, which compiled code updates.

    The output is an effort, velocity or position, depending on the controller. The set point of a
    position PID is the last command, limited to the URDF's position limits; with `interpolate` it
    moves to the command gradually (see CommandInterpolator). The error of an angular joint is the
    shortest rotation that the limits allow.
    """

    set_point, error, output = column(_SET_POINT), column(_ERROR), column(_OUTPUT)
    updates = column(_UPDATES)

    def __init__(
        self,
        row: np.ndarray,
        kind: int,
        handle: JointHandle,
        index: int,
        label: str,
        pid: Pid | None = None,
        interpolate: bool = False,
    ) -> None:
        """Create a loop of the kind `kind`, whose state is stored in `row` (39,).

        Args:
            index: index of the handle among the robot's handles.
            label: name of the controller in log lines.
        """
        self.handle, self.pid, self.row, self._kind = handle, pid, row, kind
        self._label = label
        travel = handle.position_limits if kind == POSITION_PID else None
        row[_HANDLE], row[_TARGET], row[_KIND] = index, COMMAND_COLUMNS[handle.interface], kind
        row[_IS_ANGULAR] = handle.is_angular
        row[_LOWER], row[_UPPER] = travel or (-inf, inf)
        row[_INTERPOLATES] = interpolate
        self._interpolation = CommandInterpolator(handle, row[_INTERPOLATION:])
        if pid is not None:
            pid.bind(row[:PID_COLUMNS])
        self._limit_event = RateLimitedEvent()
        self.start()

    @property
    def gains(self) -> tuple[float, float]:
        """Stiffness and damping of the loop.

        They are the decrease of the output per unit of joint position and per unit of joint
        velocity.
        """
        gains = self.pid.gains
        return (0.0, gains.p) if self._kind == SPEED_PID else (gains.p, gains.d)

    def bind(self, row: np.ndarray) -> None:
        """Copy the state of the loop to `row` (39,), and use `row` from now on."""
        row[:] = self.row
        self.row = row
        self._interpolation.row = row[_INTERPOLATION:]
        if self.pid is not None:
            self.pid.row = row[:PID_COLUMNS]

    def start(self) -> None:
        """Reset the PID. Hold the current position, or command 0 if commands are no positions."""
        row, stays = self.row, 0.0
        if self._kind == POSITION_PID or self._kind == FORWARD and row[_TARGET] == Q_COMMAND:
            stays = min(max(self.handle.position, row[_LOWER]), row[_UPPER])
        row[_COMMAND : _OUTPUT + 1] = stays, stays, 0.0, 0.0
        self._interpolation.start(stays)
        self._limit_event.reset()
        if self.pid is not None:
            self.pid.reset()

    def restart(self, time_ns: int) -> None:
        """Reset the PID and move from the current position to the last command."""
        command = self.row.item(_COMMAND)
        self.start()
        self.set_command(command, time_ns)

    def set_command(self, command: float, time_ns: int) -> None:
        """Set a command (rad, m, rad/s, m/s, N m or N) that arrived in the cycle at `time_ns`."""
        set_loop_command(self.row, command, time_ns)
        self.warn_beyond_limits(command, time_ns)

    def warn_beyond_limits(self, command: float, time_ns: int) -> None:
        """Log a warning if `command`, which was set before, is beyond the position limits."""
        reachable = self.row.item(_COMMAND)
        if abs(reachable - command) > COMMAND_ROUNDING and self._limit_event.record(time_ns):
            log.warning(
                f"controller '{self._label}': command {command:g} for joint "
                f"'{self.handle.name}' is beyond its limits [{self.row[_LOWER]:g}, "
                f"{self.row[_UPPER]:g}]; {reachable:g} is used"
            )

    def make_state(self, time_ns: int, period: float) -> JointControllerState:
        """Return the state of the loop in this cycle, as in control_msgs/JointControllerState.

        The process value is the joint's position, or its velocity for a velocity PID. For a
        velocity PID, process_value_dot is 0, because accelerations are not measured.
        """
        handle, gains = self.handle, self.pid.gains
        process = handle.position, handle.velocity
        if self._kind == SPEED_PID:
            process = handle.velocity, 0.0
        return JointControllerState(
            time_ns, self.set_point, *process, self.error, period,
            self.output, gains.p, gains.i, gains.d, gains.i_max, gains.antiwindup,
        )


@jit("f8[::1], f8, f8", allocates=False)
def set_loop_command(row, command, time_ns):
    """Set the command of a loop in the cycle at `time_ns`; return the command within the limits."""
    row[_COMMAND] = command = min(max(command, row[_LOWER]), row[_UPPER])
    if row[_INTERPOLATES] != 0.0:
        set_interpolation_target(row[_INTERPOLATION:], command, time_ns)
    else:
        row[_SET_POINT] = command
    return command


@jit("f8[:,::1], f8[::1], f8", allocates=False)
def set_loop_commands(rows, commands, time_ns):
    """Set the commands of the loops whose states are `rows`; a command of NaN is left out.

    Return whether a command was outside the position limits.
    """
    beyond = False
    for k in range(len(rows)):
        if commands[k] == commands[k]:
            beyond |= set_loop_command(rows[k], commands[k], time_ns) != commands[k]
    return beyond


@jit("f8[:,::1], f8[:,::1], f8", allocates=False)
def update_loops(rows, handles, period):
    """Compute the outputs of the loops whose states are `rows`, and write them to `handles`.

    `handles` (h, 6) contains the rows of the robot's h joint handles. `period` is the time since
    the last update, s.
    """
    for k in range(len(rows)):
        row = rows[k]
        handle = handles[int(row[_HANDLE])]
        if row[_KIND] == FORWARD:
            output = row[_SET_POINT]
        else:
            if row[_KIND] == SPEED_PID:
                error = row[_SET_POINT] - handle[V]
            else:
                way = row[_INTERPOLATION:]
                if row[_INTERPOLATES] != 0.0 and way[IS_MOVING] != 0.0:
                    row[_SET_POINT] = advance_interpolation(way, period)
                position, set_point = handle[Q], row[_SET_POINT]
                error = set_point - position
                if (
                    row[_IS_ANGULAR] != 0.0
                    and not -LARGEST_PLAIN_DIFFERENCE < error < LARGEST_PLAIN_DIFFERENCE
                ):
                    error = angular_distance_within_limits(
                        position, set_point, row[_LOWER], row[_UPPER]
                    )
            row[_ERROR] = error
            output = compute_pid(row[:PID_COLUMNS], error, 0.0, False, period)
        row[_OUTPUT] = output
        row[_UPDATES] += 1.0
        handle[int(row[_TARGET])] = output
