"""The position loop that PID controllers of one joint and of several share."""

from collections.abc import Callable, Sequence
from math import inf

from aras_sim_bridge import angles
from aras_sim_bridge.control.controllers.base import JointControllerState
from aras_sim_bridge.control.controllers.interpolation import Interpolation
from aras_sim_bridge.control.joints import JointHandle, Occurrence
from aras_sim_bridge.control.pid import Pid

PLAIN_DIFFERENCE = 3.14  # rad; within half a turn, and inside the limits, it is the short way
_RESTS = (False, 0.0, 0.0, 0.0, 0.0, 0.0)


class PositionLoop:
    """Output of a position PID for one joint (effort or velocity, as the gains mean it).

    The set point is the last command within the URDF's limits; with `interpolate` it moves there
    instead of stepping. The error goes the short way round where the joint and its limits allow.
    """

    __slots__ = ("handle", "pid", "set_point", "error", "output", "wraps", "_limited", "_lower",
                 "_upper", "_beyond", "_warn", "_label", "_interpolation", "_command")

    def __init__(
        self,
        handle: JointHandle,
        pid: Pid,
        warn: Callable[[str], None],
        label: str,
        interpolate: bool = False,
    ) -> None:
        self.handle = handle
        self.pid = pid
        self._warn = warn
        self._label = label
        travel = handle.travel
        self._limited = travel is not None
        self._lower, self._upper = travel or (-inf, inf)
        self.wraps = handle.kind in ("revolute", "continuous")
        self._beyond = Occurrence()
        self._interpolation = Interpolation(handle) if interpolate else None
        self.start()

    def start(self) -> None:
        """Hold the present position, within the limits, with a fresh PID."""
        self.set_point = self._command = min(max(self.handle.position, self._lower), self._upper)
        if self._interpolation is not None:
            self._interpolation.start(self.set_point)
        self.error = 0.0
        self.output = 0.0
        self._beyond.reset()
        self.pid.reset()

    def begin_anew(self, time_ns: int) -> None:
        """Start from the present position towards the last command, with a fresh PID."""
        command = self._command
        self.start()
        self.take(command, time_ns)

    def take(self, command: float, time_ns: int) -> None:
        """Go to `command` (rad or m), which arrived in the cycle at `time_ns`."""
        reachable = min(max(command, self._lower), self._upper)
        if reachable != command and self._beyond.note(time_ns):
            self._warn(
                f"controller '{self._label}': command {command:g} for joint "
                f"'{self.handle.name}' is beyond its limits [{self._lower:g}, "
                f"{self._upper:g}]; {reachable:g} is used"
            )
        self._command = reachable
        if self._interpolation is not None:
            self._interpolation.take(reachable, time_ns)
        else:
            self.set_point = reachable

    def compute(self, period: float) -> float:
        """The PID's output for this cycle."""
        interpolation = self._interpolation
        if interpolation is not None and interpolation.moves:
            self.set_point = interpolation.advance(period)
        position = self.handle.position
        error = self.set_point - position
        if self.wraps and not (-PLAIN_DIFFERENCE < error < PLAIN_DIFFERENCE):
            if self._limited:
                error = angles.towards(position, self.set_point, self._lower, self._upper)
            else:
                error = angles.shortest(position, self.set_point)
        self.error = error
        self.output = output = self.pid.compute(error, period)
        return output

    def begin_stride(self) -> tuple[float, ...]:
        """What `compute` goes by (9): the set point's way, set point, the PID's last error and
        integral."""
        interpolation = self._interpolation
        way = _RESTS if interpolation is None else interpolation.on_the_way()
        return *way, self.set_point, *self.pid.memory

    def end_stride(self, reached: Sequence[float]) -> None:
        """Be as after so many cycles: the same numbers, then what the last of them measured (3),
        its error, the error's derivative and its output."""
        self.set_point, integral = reached[6], reached[8]
        if self._interpolation is not None:
            self._interpolation.go_on(*reached[:4])
        handle = self.handle
        handle.position, handle.velocity, handle.effort, self.error, error_dot, self.output = (
            reached[9:]
        )
        self.pid.remember(self.error, error_dot, integral, self.output)
        handle.effort_command = self.output

    def state(self, time_ns: int, period: float) -> JointControllerState:
        """This cycle as the state topic shows it."""
        handle, gains = self.handle, self.pid.gains
        return JointControllerState(
            time_ns, self.set_point, handle.position, handle.velocity, self.error, period,
            self.output, gains.p, gains.i, gains.d, gains.i_max, gains.antiwindup,
        )
