"""Control cycles in a row, without a look at anything else, for a robot that position PIDs drive.

Between two joint states of a study's run nothing asks for the cycles' order: no listener, no new
command, no picture. Here all joints of such a cycle are computed at once, number for number what
PositionLoop, Interpolation, Pid and EffortSaturation make of them one by one; a cycle in which
one of those would do anything out of the ordinary (a report, the other way round, a number that is
not finite) is left to them.
"""

from collections.abc import Mapping, Sequence
from math import isfinite

import numpy as np

from aras_sim_bridge.control.controllers.base import Controller
from aras_sim_bridge.control.controllers.pid_controllers import PidPositionController
from aras_sim_bridge.control.controllers.pid_loops import PositionLoop
from aras_sim_bridge.control.drives import EffortDrive
from aras_sim_bridge.control.hardware import RobotHardware
from aras_sim_bridge.control.joints import EFFORT
from aras_sim_bridge.control.pid import Gains
from aras_visual_servo_base.compiled import compiled

# Columns of a joint's row: what a stride goes by and changes (see PositionLoop.begin_stride),
_MOVES, _LEFT, _LINE, _VALUE, _COMMAND, _RATE, _SET_POINT, _LAST_ERROR, _INTEGRAL = range(9)
# what its last cycle measured and gave,
_POSITION, _VELOCITY, _EFFORT, _ERROR, _ERROR_DOT, _OUTPUT = range(9, 15)
_BEGUN, _REACHED = 9, 15
# the same of the cycle under way, until all joints are known to be ordinary (as many again),
# and what stays: gains (of pid.Gains), whether the joint turns, its limits and its number.
_P, _I, _D, _I_MAX, _I_MIN, _ANTIWINDUP = range(30, 36)
_WRAPS, _LOWER, _UPPER, _FASTEST, _STRONGEST, _JOINT = range(36, 42)
_COLUMNS = 42


@compiled("f8[:,::1], f8[:,::1], f8, f8, f8, f8")
def cycle(state, rows, dt, arrived, rounding, plain):
    """One cycle of `dt` s: efforts of the joints into state[2].

    arrived, rounding, plain: the constants of interpolation.py and pid_loops.py, which numba would
    keep as they were when it compiled this.

    Returns:
        Whether it was made; nothing is changed where not.
    """
    for k in range(len(rows)):
        r = rows[k]
        j = int(r[_JOINT])
        position, velocity = state[0, j], state[1, j]
        moves, left, line, value = r[_MOVES], r[_LEFT], r[_LINE], r[_VALUE]
        set_point = r[_SET_POINT]
        if moves != 0.0:
            left -= dt
            if left > 0.0:
                line += r[_RATE] * dt
            else:
                line = r[_COMMAND]
            if left <= 0.0 and -arrived < line - value < arrived:
                moves, value = 0.0, line
            else:
                value += (line - value) * dt / (rounding + dt)
            set_point = value
        error = set_point - position
        if not isfinite(error):
            return False
        if r[_WRAPS] != 0.0 and not -plain < error < plain:
            return False
        error_dot = (error - r[_LAST_ERROR]) / dt
        integral = r[_INTEGRAL] + dt * error
        i = r[_I]
        if r[_ANTIWINDUP] != 0.0 and i != 0.0:
            low, high = r[_I_MIN] / i, r[_I_MAX] / i
            if low > high:
                low, high = high, low
            integral = low if integral < low else high if integral > high else integral
            i_term = i * integral
        else:
            i_term = i * integral
            if r[_ANTIWINDUP] == 0.0:
                least, most = r[_I_MIN], r[_I_MAX]
                i_term = least if i_term < least else most if i_term > most else i_term
        output = r[_P] * error + i_term + r[_D] * error_dot
        high = r[_STRONGEST]
        low = -high
        if position < r[_LOWER]:
            low = 0.0
        elif position > r[_UPPER]:
            high = 0.0
        if velocity < -r[_FASTEST]:
            low = 0.0
        elif velocity > r[_FASTEST]:
            high = 0.0
        if not (low <= output <= high and isfinite(error_dot) and isfinite(output)):
            return False
        n = r[_REACHED:]
        n[_MOVES], n[_LEFT], n[_LINE], n[_VALUE] = moves, left, line, value
        n[_COMMAND], n[_RATE] = r[_COMMAND], r[_RATE]
        n[_SET_POINT], n[_LAST_ERROR], n[_INTEGRAL] = set_point, error, integral
        n[_POSITION], n[_VELOCITY], n[_EFFORT] = position, velocity, state[2, j]
        n[_ERROR], n[_ERROR_DOT], n[_OUTPUT] = error, error_dot, output
    state[2] = 0.0
    for k in range(len(rows)):
        r = rows[k]
        for c in range(_REACHED):
            r[c] = r[_REACHED + c]
        state[2, int(r[_JOINT])] += r[_OUTPUT]
    return True


class Stride:
    """Cycles in a row of these loops, which together command all drives of a robot.

    Attributes:
        rows (m, 42): what `cycle` goes by and changes, a row a joint.
        made: cycles since `begin`, to be counted by whoever makes them.
    """

    def __init__(self, loops: Sequence[PositionLoop], drives: Sequence[EffortDrive],
                 slots: Mapping[str, int]) -> None:
        """`drives`: those of the loops' joints; `slots`: where joints stand in the model's order.
        """
        self.loops, self.drives = tuple(loops), tuple(drives)
        self.made = 0
        self.rows = np.zeros((len(self.loops), _COLUMNS))
        self._gains: list[Gains | None] = [None] * len(self.loops)
        for row, loop, drive in zip(self.rows, self.loops, self.drives, strict=True):
            row[_WRAPS:] = (loop.wraps, *drive.saturation, slots[loop.handle.name])

    def begin(self) -> None:
        """Take over what loops and PIDs have come to."""
        self.made = 0
        for k, loop in enumerate(self.loops):
            gains = loop.pid.gains
            if gains is not self._gains[k]:
                self._gains[k] = gains
                self.rows[k, _P : _ANTIWINDUP + 1] = gains
        self.rows[:, :_BEGUN] = [loop.begin_stride() for loop in self.loops]

    def end(self) -> None:
        """Give back what the cycles have come to."""
        if self.made:
            rows = self.rows[:, :_REACHED].tolist()
            for loop, drive, row in zip(self.loops, self.drives, rows, strict=True):
                loop.end_stride(row)
                drive.written()


def stride_of(controllers: Sequence[Controller], hardware: RobotHardware) -> Stride | None:
    """The stride of a robot whose running controllers these are; None where not every drive is
    that of an effort that one position loop gives."""
    loops = {
        loop.handle.name: loop
        for controller in controllers
        if isinstance(controller, PidPositionController) and controller.interface == EFFORT
        for loop in controller.loops
    }
    drives = {drive.handle.name: drive for drive in hardware.drives}
    plain = (isinstance(d, EffortDrive) and d.saturation is not None for d in drives.values())
    if loops.keys() != drives.keys() or not all(plain):
        return None
    slots = {name: k for k, name in enumerate(hardware.model.joint_names)}
    return Stride([loops[name] for name in drives], list(drives.values()), slots)
