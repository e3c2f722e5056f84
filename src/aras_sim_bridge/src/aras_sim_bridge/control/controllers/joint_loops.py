"""The loop of one joint that a commanded controller closes, or hands its command through."""

from collections.abc import Callable
from math import inf

import numpy as np

from aras_sim_bridge.angles import towards
from aras_sim_bridge.control.controllers.base import JointControllerState
from aras_sim_bridge.control.controllers.interpolation import (
    INTERPOLATION_COLUMNS,
    MOVES,
    Interpolation,
    headed,
    moved,
)
from aras_sim_bridge.control.joints import (
    COMMAND_ROUNDING,
    Q_COMMAND,
    JointHandle,
    Occurrence,
    Q,
    V,
)
from aras_sim_bridge.control.pid import PID_COLUMNS, Pid, computed
from aras_visual_servo_base.compiled import column, compiled

PLAIN_DIFFERENCE = 3.14  # rad; within half a turn, and inside the limits, it is the short way

# What becomes of a command: it is handed on, or is the set point of a position or a speed PID.
FORWARD, POSITION_PID, SPEED_PID = range(3)
# Columns of a loop's row: those of a Pid, these, and those of an Interpolation. Which handle of the
# robot's, which of its commands, which kind; whether the joint turns, its limits; last command,
# set point, error and output; whether set points are interpolated; updates made.
(_HANDLE, _TARGET, _KIND, _TURNS, _LOWER, _UPPER, _COMMAND, _SET_POINT, _ERROR, _OUTPUT,
 _INTERPOLATES, _UPDATES, _WAY) = range(PID_COLUMNS, PID_COLUMNS + 13)
LOOP_COLUMNS = _WAY + INTERPOLATION_COLUMNS


class JointLoop:
    """Output for one joint: effort, velocity or position, as the gains mean it; a view of its row.

    The set point of a position PID is the last command within the URDF's limits; with `interpolate`
    it moves there instead of stepping. The error goes the short way round where the joint and its
    limits allow.
    """

    __slots__ = ("handle", "pid", "row", "_kind", "_beyond", "_warn", "_label", "_interpolation")

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
        travel = handle.travel if kind == POSITION_PID else None
        row[_HANDLE : _UPPER + 1] = index, target, kind, handle.turns, *(travel or (-inf, inf))
        row[_INTERPOLATES] = interpolate
        self._interpolation = Interpolation(handle, row[_WAY:])
        if pid is not None:
            pid.bind(row[:PID_COLUMNS])
        self._beyond = Occurrence()
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
        self._interpolation.row = row[_WAY:]
        if self.pid is not None:
            self.pid.row = row[:PID_COLUMNS]

    def start(self) -> None:
        """Hold the present position within the limits, or be at rest, with a fresh PID."""
        row, stays = self.row, 0.0
        if self._kind == POSITION_PID or self._kind == FORWARD and row[_TARGET] == Q_COMMAND:
            stays = min(max(self.handle.position, row[_LOWER]), row[_UPPER])
        row[_COMMAND : _OUTPUT + 1] = stays, stays, 0.0, 0.0
        self._interpolation.start(stays)
        self._beyond.reset()
        if self.pid is not None:
            self.pid.reset()

    def begin_anew(self, time_ns: int) -> None:
        """Start from the present position towards the last command, with a fresh PID."""
        command = self.row.item(_COMMAND)
        self.start()
        self.take(command, time_ns)

    def take(self, command: float, time_ns: int) -> None:
        """Go to `command` (rad, m or per s, N m, N), which arrived in the cycle at `time_ns`."""
        taken(self.row, command, time_ns)
        self.told(command, time_ns)

    def told(self, command: float, time_ns: int) -> None:
        """Say that a command which was taken is beyond the limits, if it is."""
        reachable = self.row.item(_COMMAND)
        if abs(reachable - command) > COMMAND_ROUNDING and self._beyond.note(time_ns):
            self._warn(
                f"controller '{self._label}': command {command:g} for joint "
                f"'{self.handle.name}' is beyond its limits [{self.row[_LOWER]:g}, "
                f"{self.row[_UPPER]:g}]; {reachable:g} is used"
            )

    def state(self, time_ns: int, period: float) -> JointControllerState:
        """This cycle as the state topic shows it; of a speed, process_value_dot stays 0."""
        handle, gains = self.handle, self.pid.gains
        process = handle.position, handle.velocity
        if self._kind == SPEED_PID:
            process = handle.velocity, 0.0
        return JointControllerState(
            time_ns, self.set_point, *process, self.error, period,
            self.output, gains.p, gains.i, gains.d, gains.i_max, gains.antiwindup,
        )


@compiled("f8[::1], f8, f8", allocates=False)
def taken(row, command, time_ns):
    """Let a loop go to a command, which arrived in the cycle at `time_ns`; where, within limits."""
    row[_COMMAND] = command = min(max(command, row[_LOWER]), row[_UPPER])
    if row[_INTERPOLATES] != 0.0:
        headed(row[_WAY:], command, time_ns)
    else:
        row[_SET_POINT] = command
    return command


@compiled("f8[:,::1], f8[::1], f8", allocates=False)
def taken_together(rows, commands, time_ns):
    """Let loops go to their commands, where these are numbers; whether one is beyond its limits."""
    beyond = False
    for k in range(len(rows)):
        if commands[k] == commands[k]:
            beyond |= taken(rows[k], commands[k], time_ns) != commands[k]
    return beyond


@compiled("f8[:,::1], f8[:,::1], f8", allocates=False)
def follow(rows, handles, period):
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
                way = row[_WAY:]
                if row[_INTERPOLATES] != 0.0 and way[MOVES] != 0.0:
                    row[_SET_POINT] = moved(way, period)
                position, set_point = handle[Q], row[_SET_POINT]
                error = set_point - position
                if row[_TURNS] != 0.0 and not -PLAIN_DIFFERENCE < error < PLAIN_DIFFERENCE:
                    error = towards(position, set_point, row[_LOWER], row[_UPPER])
            row[_ERROR] = error
            output = computed(row[:PID_COLUMNS], error, 0.0, False, period)
        row[_OUTPUT] = output
        row[_UPDATES] += 1.0
        handle[int(row[_TARGET])] = output
