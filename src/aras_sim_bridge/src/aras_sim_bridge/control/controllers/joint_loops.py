"""The loop of one joint that a commanded controller closes, or hands its command through."""

from collections.abc import Callable
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
    COMMAND_ROUNDING,
    Q_COMMAND,
    JointHandle,
    Q,
    RateLimitedEvent,
    V,
)
from aras_sim_bridge.control.pid import PID_COLUMNS, Pid, compute_pid
from aras_visual_servo_base.compiled import column, jit

# rad; within half a turn, and inside the limits, it is the short way
LARGEST_PLAIN_DIFFERENCE = 3.14

# What becomes of a command: it is handed on, or is the set point of a position or a speed PID.
FORWARD, POSITION_PID, SPEED_PID = range(3)
# Columns of a loop's row: those of a Pid, these, and those of an Interpolation. Which handle of the
# robot's, which of its commands, which kind; whether the joint turns, its limits; last command,
# set point, error and output; whether set points are interpolated; updates made.
(_HANDLE, _TARGET, _KIND, _IS_ANGULAR, _LOWER, _UPPER, _COMMAND, _SET_POINT, _ERROR, _OUTPUT,
 _INTERPOLATES, _UPDATES, _INTERPOLATION) = range(PID_COLUMNS, PID_COLUMNS + 13)
LOOP_COLUMNS = _INTERPOLATION + INTERPOLATION_COLUMNS


class JointLoop:
    """Output for one joint: effort, velocity or position, as the gains mean it; a view of its row.

    The set point of a position PID is the last command within the URDF's limits; with `interpolate`
    it moves there instead of stepping. The error goes the short way round where the joint and its
    limits allow.
    """

    __slots__ = (
        "handle",
        "pid",
        "row",
        "_kind",
        "_limit_event",
        "_warn",
        "_label",
        "_interpolation",
    )

    set_point, error, output = column(_SET_POINT), column(_ERROR), column(_OUTPUT)
    updates = column(_UPDATES)

    def __init__(
        self,
        row: np.ndarray,
        kind: int,
        handle: JointHandle,
        index: int,
        target: int,
        warn: Callable[[str], None],
        label: str,
        pid: Pid | None = None,
        interpolate: bool = False,
    ) -> None:
        """A loop of this kind in a row (39,) of its controller's.

        Args:
            index: of the handle among the robot's. target: column of its command.
            warn: takes a line for the log. label: the controller's name there.
        """
        self.handle, self.pid, self.row, self._kind = handle, pid, row, kind
        self._warn, self._label = warn, label
        travel = handle.position_limits if kind == POSITION_PID else None
        row[_HANDLE : _UPPER + 1] = index, target, kind, handle.is_angular, *(travel or (-inf, inf))
        row[_INTERPOLATES] = interpolate
        self._interpolation = CommandInterpolator(handle, row[_INTERPOLATION:])
        if pid is not None:
            pid.bind(row[:PID_COLUMNS])
        self._limit_event = RateLimitedEvent()
        self.start()

    @property
    def gains(self) -> tuple[float, float]:
        """How much the output falls with the joint's position, and with its velocity."""
        gains = self.pid.gains
        return (0.0, gains.p) if self._kind == SPEED_PID else (gains.p, gains.d)

    def bind(self, row: np.ndarray) -> None:
        """Go on in this row (39,)."""
        row[:] = self.row
        self.row = row
        self._interpolation.row = row[_INTERPOLATION:]
        if self.pid is not None:
            self.pid.row = row[:PID_COLUMNS]

    def start(self) -> None:
        """Hold the present position within the limits, or be at rest, with a fresh PID."""
        row, stays = self.row, 0.0
        if self._kind == POSITION_PID or self._kind == FORWARD and row[_TARGET] == Q_COMMAND:
            stays = min(max(self.handle.position, row[_LOWER]), row[_UPPER])
        row[_COMMAND : _OUTPUT + 1] = stays, stays, 0.0, 0.0
        self._interpolation.start(stays)
        self._limit_event.reset()
        if self.pid is not None:
            self.pid.reset()

    def restart(self, time_ns: int) -> None:
        """Start from the present position towards the last command, with a fresh PID."""
        command = self.row.item(_COMMAND)
        self.start()
        self.set_command(command, time_ns)

    def set_command(self, command: float, time_ns: int) -> None:
        """Go to `command` (rad, m or per s, N m, N), which arrived in the cycle at `time_ns`."""
        set_loop_command(self.row, command, time_ns)
        self.warn_beyond_limits(command, time_ns)

    def warn_beyond_limits(self, command: float, time_ns: int) -> None:
        """Say that a command which was taken is beyond the limits, if it is."""
        reachable = self.row.item(_COMMAND)
        if abs(reachable - command) > COMMAND_ROUNDING and self._limit_event.record(time_ns):
            self._warn(
                f"controller '{self._label}': command {command:g} for joint "
                f"'{self.handle.name}' is beyond its limits [{self.row[_LOWER]:g}, "
                f"{self.row[_UPPER]:g}]; {reachable:g} is used"
            )

    def make_state(self, time_ns: int, period: float) -> JointControllerState:
        """This cycle as the state topic shows it; of a speed, process_value_dot stays 0."""
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
    """Let a loop go to a command, which arrived in the cycle at `time_ns`; where, within limits."""
    row[_COMMAND] = command = min(max(command, row[_LOWER]), row[_UPPER])
    if row[_INTERPOLATES] != 0.0:
        set_interpolation_target(row[_INTERPOLATION:], command, time_ns)
    else:
        row[_SET_POINT] = command
    return command


@jit("f8[:,::1], f8[::1], f8", allocates=False)
def set_loop_commands(rows, commands, time_ns):
    """Let loops go to their commands, where these are numbers; whether one is beyond its limits."""
    beyond = False
    for k in range(len(rows)):
        if commands[k] == commands[k]:
            beyond |= set_loop_command(rows[k], commands[k], time_ns) != commands[k]
    return beyond


@jit("f8[:,::1], f8[:,::1], f8", allocates=False)
def update_loops(rows, handles, period):
    """One cycle of loops, `period` s after the last one: their outputs into the handles (h, 6)."""
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
