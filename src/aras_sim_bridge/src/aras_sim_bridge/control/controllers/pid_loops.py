"""The PID loops that several controllers share: one joint's position, one joint's velocity."""

from collections.abc import Callable

from aras_sim_bridge import angles
from aras_sim_bridge.control.controllers.base import JointControllerState
from aras_sim_bridge.control.controllers.interpolation import Interpolation
from aras_sim_bridge.control.joints import JointHandle, Occurrence
from aras_sim_bridge.control.pid import Pid


class PositionLoop:
    """Output of a position PID for one joint (effort or velocity, as the gains mean it).

    The set point is clamped to the URDF's limits in each cycle's copy, `command` stays as it was
    given; the error goes the short way round where the joint and its limits allow. With
    `interpolate` the set point moves from command to command instead of stepping.
    """

    __slots__ = ("handle", "pid", "command", "set_point", "error", "output", "_wraps", "_lower",
                 "_upper", "_limited", "_beyond", "_warn", "_label", "_interpolation")

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
        self._lower, self._upper = travel or (float("-inf"), float("inf"))
        self._wraps = handle.kind in ("revolute", "continuous")
        self._beyond = Occurrence()
        self._interpolation = Interpolation(handle) if interpolate else None
        self.start()

    def start(self) -> None:
        """Hold the present position, within the limits, with a fresh PID."""
        position = self.handle.position
        self.command = self.set_point = min(max(position, self._lower), self._upper)
        if self._interpolation is not None:
            self._interpolation.start(self.command)
        self.error = 0.0
        self.output = 0.0
        self._beyond.reset()
        self.pid.reset()

    def take(self, command: float, time_ns: int) -> None:
        """Go to `command` (rad or m), which arrived in the cycle at `time_ns`."""
        self.command = command
        if self._interpolation is not None:
            self._interpolation.take(min(max(command, self._lower), self._upper), time_ns)

    def compute(self, time_ns: int, period: float) -> float:
        """The PID's output for this cycle."""
        command = self.command
        position = self.handle.position
        lower, upper = self._lower, self._upper
        if not lower <= command <= upper:
            command = self._clamp(command, time_ns)
        if self._interpolation is not None:
            command = self._interpolation.advance(period)
        error = command - position
        # Within half a turn, and inside the limits, the plain difference is the short way.
        if self._wraps and not (-3.14 < error < 3.14):
            if self._limited:
                error = angles.with_large_limits(position, command, lower, upper)
            else:
                error = angles.shortest(position, command)
        self.set_point = command
        self.error = error
        self.output = output = self.pid.compute(error, period)
        return output

    def _clamp(self, command: float, time_ns: int) -> float:
        clamped = self._lower if command < self._lower else self._upper
        if self._beyond.note(time_ns):
            self._warn(
                f"controller '{self._label}': command {command:g} for joint "
                f"'{self.handle.name}' is beyond its limits [{self._lower:g}, "
                f"{self._upper:g}]; {clamped:g} is used"
            )
        return clamped

    def state(self, time_ns: int, period: float) -> JointControllerState:
        """This cycle as the state topic shows it."""
        handle, gains = self.handle, self.pid.gains
        return JointControllerState(
            time_ns, self.set_point, handle.position, handle.velocity, self.error, period,
            self.output, gains.p, gains.i, gains.d, gains.i_max, gains.antiwindup,
        )
