"""Single-joint PID controllers, whatever their output means."""

from collections.abc import Mapping
from typing import Any

from aras_sim_bridge import parameters as params
from aras_sim_bridge.control.controllers.base import (
    STATE_EVERY,
    Context,
    Controller,
    JointControllerState,
    checked_number,
)
from aras_sim_bridge.control.controllers.forward import COMMAND_OF
from aras_sim_bridge.control.controllers.pid_loops import PositionLoop
from aras_sim_bridge.control.pid import Pid


class _PidController(Controller):
    """Parameters: `joint`, `pid/...` (see Pid.from_parameters)."""

    command_kind = "float64"
    state_kind = "joint_controller_state"

    def init(self, hardware: Any, parameters: Mapping, context: Context) -> None:
        """Raises ControllerError for a missing joint, gain, or joint of that interface."""
        super().init(hardware, parameters, context)
        joint = params.name(parameters, "joint", context.where)
        gains = params.section(parameters, "pid", context.where)
        self.pid = Pid.from_parameters(gains, f"{context.where}/pid")
        self.handle = self.take_handle(hardware, joint)
        self.joints = (joint,)
        self.pids = {"pid": self.pid}
        self._target = COMMAND_OF[self.interface]
        # Never reset, so the first update of all is published and then every tenth.
        self._updates = 0

    def _publish(self, time_ns: int, period: float) -> None:
        listener = self.on_state  # another thread may take it away at any time
        if listener is not None:
            listener(self.state(time_ns, period))

    def state(self, time_ns: int, period: float) -> JointControllerState:
        """This cycle as the state topic shows it."""
        raise NotImplementedError


class PidPositionController(_PidController):
    """output = PID(position error), the set point within the URDF's limits.

    Parameter beside those of the base: `interpolate` (see PositionLoop).
    """

    def init(self, hardware: Any, parameters: Mapping, context: Context) -> None:
        """Raises ControllerError for a missing joint, gain, or joint of that interface."""
        super().init(hardware, parameters, context)
        interpolate = bool(params.flag(parameters, "interpolate", context.where))
        self._loop = PositionLoop(self.handle, self.pid, context.warn, context.name, interpolate)

    def starting(self, time_ns: int) -> None:
        """Hold the present position."""
        super().starting(time_ns)
        self._loop.start()

    def update(self, time_ns: int, period: float) -> None:
        """Command the PID's output."""
        if self.slot:
            self._loop.take(self.slot.pop(), time_ns)
        setattr(self.handle, self._target, self._loop.compute(period))
        if self._updates % STATE_EVERY == 0:
            self._publish(time_ns, period)
        self._updates += 1

    def state(self, time_ns: int, period: float) -> JointControllerState:
        """This cycle as the state topic shows it."""
        return self._loop.state(time_ns, period)

    def set_command(self, value: float) -> None:
        """Position in rad or m. Raises ControllerError if it is not finite."""
        self.slot.append(checked_number(value, self.context.name))


class PidVelocityController(_PidController):
    """output = PID(velocity error)."""

    def init(self, hardware: Any, parameters: Mapping, context: Context) -> None:
        """Raises ControllerError for a missing joint, gain, or joint of that interface."""
        super().init(hardware, parameters, context)
        self._command = self._set_point = self._error = self._output = 0.0

    def starting(self, time_ns: int) -> None:
        """Come to rest."""
        super().starting(time_ns)
        self._command = 0.0
        self.pid.reset()

    def update(self, time_ns: int, period: float) -> None:
        """Command the PID's output."""
        if self.slot:
            self._command = self.slot.pop()
        self._set_point = command = self._command
        self._error = command - self.handle.velocity
        self._output = self.pid.compute(self._error, period)
        setattr(self.handle, self._target, self._output)
        if self._updates % STATE_EVERY == 0:
            self._publish(time_ns, period)
        self._updates += 1

    def state(self, time_ns: int, period: float) -> JointControllerState:
        """This cycle as the state topic shows it; process_value_dot stays 0."""
        gains = self.pid.gains
        return JointControllerState(
            time_ns, self._set_point, self.handle.velocity, 0.0, self._error, period,
            self._output, gains.p, gains.i, gains.d, gains.i_max, gains.antiwindup,
        )

    def set_command(self, value: float) -> None:
        """Velocity in rad/s or m/s. Raises ControllerError if it is not finite."""
        self.slot.append(checked_number(value, self.context.name))
