"""PID controllers of single joints and of groups."""

from collections.abc import Mapping, Sequence

from aras_sim_bridge import parameters as params
from aras_sim_bridge.control.controllers.base import (
    STATE_EVERY,
    Context,
    Controller,
    JointControllerState,
    checked_number,
)
from aras_sim_bridge.control.controllers.forward import COMMAND_OF, checked_numbers
from aras_sim_bridge.control.controllers.pid_loops import PositionLoop
from aras_sim_bridge.control.controllers.registry import register
from aras_sim_bridge.control.hardware import RobotHardware
from aras_sim_bridge.control.joints import EFFORT, VELOCITY
from aras_sim_bridge.control.pid import Pid


class _PidController(Controller):
    """Parameters: `joint`, `pid/...` (see Pid.from_parameters)."""

    command_kind = "float64"
    state_kind = "joint_controller_state"

    def init(self, hardware: RobotHardware, parameters: Mapping, context: Context) -> None:
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

    def init(self, hardware: RobotHardware, parameters: Mapping, context: Context) -> None:
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

    def init(self, hardware: RobotHardware, parameters: Mapping, context: Context) -> None:
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


@register("effort_controllers/JointPositionController")
class EffortJointPositionController(PidPositionController):
    """effort = PID(position error); not clamped here but by the limit handle."""

    interface = EFFORT


@register("velocity_controllers/JointPositionController")
class VelocityJointPositionController(PidPositionController):
    """velocity = PID(position error)."""

    interface = VELOCITY


@register("effort_controllers/JointVelocityController")
class EffortJointVelocityController(PidVelocityController):
    """effort = PID(velocity error)."""

    interface = EFFORT


@register("effort_controllers/JointGroupPositionController")
class GroupEffortPositionController(Controller):
    """effort = PID(position error), joint by joint. Parameters: `joints`, `<joint>/pid/...`,
    `interpolate` (see PositionLoop).
    """

    interface = EFFORT
    command_kind = "float64_array"

    def init(self, hardware: RobotHardware, parameters: Mapping, context: Context) -> None:
        """Raises ControllerError for a missing joint or gain."""
        super().init(hardware, parameters, context)
        joints = params.names(parameters, "joints", context.where)
        interpolate = bool(params.flag(parameters, "interpolate", context.where))
        self._loops = []
        for joint in joints:
            own = params.section(parameters, joint, context.where)
            where = f"{context.where}/{joint}"
            pid = Pid.from_parameters(params.section(own, "pid", where), f"{where}/pid")
            handle = self.take_handle(hardware, joint)
            self._loops.append(PositionLoop(handle, pid, context.warn, context.name, interpolate))
            self.pids[f"{joint}/pid"] = pid
        self.joints = joints

    def starting(self, time_ns: int) -> None:
        """Hold the present positions."""
        super().starting(time_ns)
        for loop in self._loops:
            loop.start()

    def update(self, time_ns: int, period: float) -> None:
        """Command each PID's effort."""
        if self.slot:
            for loop, command in zip(self._loops, self.slot.pop(), strict=True):
                loop.take(command, time_ns)
        for loop in self._loops:
            loop.handle.effort_command = loop.compute(period)

    def set_command(self, value: Sequence[float]) -> None:
        """Positions in rad or m, in the order of `joints`.

        Raises ControllerError, keeping the last command, on a wrong length or a number that is
        not finite.
        """
        self.slot.append(checked_numbers(value, self.joints, self.context.name))
