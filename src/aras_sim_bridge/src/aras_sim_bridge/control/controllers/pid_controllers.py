"""PID controllers of single joints and of groups."""

from collections.abc import Mapping
from math import inf

from aras_sim_bridge.control.controllers.base import STATE_EVERY, Context, JointControllerState
from aras_sim_bridge.control.controllers.forward import CommandedController
from aras_sim_bridge.control.controllers.pid_loops import PositionLoop
from aras_sim_bridge.control.controllers.registry import register
from aras_sim_bridge.control.hardware import RobotHardware
from aras_sim_bridge.control.joints import EFFORT, VELOCITY
from aras_sim_bridge.control.pid import Pid
from aras_sim_bridge.errors import ControllerError
from aras_visual_servo_base.settings import read


class PidController(CommandedController):
    """Parameters beside the joints: `pid/...` of a single one, `<joint>/pid/...` of a group's (see
    Pid.from_parameters). A single one tells its state.
    """

    state_kind = "joint_controller_state"

    def init(self, hardware: RobotHardware, parameters: Mapping, context: Context) -> None:
        """Raises ControllerError for a missing joint, gain, or joint of that interface."""
        super().init(hardware, parameters, context)
        for joint in self.joints:
            own, path = parameters, "pid"
            if self.is_group:
                own = read(parameters, joint, Mapping, context.where, ControllerError, {})
                path = f"{joint}/pid"
            where = f"{context.where}/{path}"
            gains = read(own, "pid", Mapping, where.removesuffix("/pid"), ControllerError, {})
            self.pids[path] = Pid.from_parameters(gains, where)
        # Never reset, so the first update of all is published and then every tenth.
        self._updates = 0

    def _tell(self, time_ns: int, period: float) -> None:
        """Publish this cycle's state, if anybody listens."""
        listener = self.on_state
        if listener is not None:
            listener(self.state(time_ns, period))

    def state(self, time_ns: int, period: float) -> JointControllerState:
        """This cycle as the state topic shows it."""
        raise NotImplementedError


@register("effort_controllers/JointPositionController", interface=EFFORT)
@register("velocity_controllers/JointPositionController", interface=VELOCITY)
class PidPositionController(PidController):
    """effort or velocity = PID(position error), set points (rad, m) within the URDF's limits.

    The output is clamped by the limit handle, not here. Parameter beside those of the base:
    `interpolate` (see PositionLoop).
    """

    def init(self, hardware: RobotHardware, parameters: Mapping, context: Context) -> None:
        """Raises ControllerError for a missing joint, gain, or joint of that interface."""
        super().init(hardware, parameters, context)
        interpolate = read(parameters, "interpolate", bool, context.where, ControllerError, False)
        self.loops = [
            PositionLoop(handle, pid, context.warn, context.name, interpolate)
            for handle, pid in zip(self.handles, self.pids.values(), strict=True)
        ]

    def starting(self, time_ns: int) -> None:
        """Hold the present positions."""
        super().starting(time_ns)
        for loop in self.loops:
            loop.start()

    def begin_anew(self, time_ns: int) -> None:
        """Start from where the joints are towards the last commands."""
        for loop in self.loops:
            loop.begin_anew(time_ns)

    def calm_until(self, time_ns: int) -> float:
        """For good, while nobody listens."""
        if self.on_state is not None or type(self).update is not PidPositionController.update:
            return -inf  # somebody listens, or it is a user's own
        for pid in self.pids.values():
            if pid.on_state:
                return -inf
        return inf

    def begin_stride(self, time_ns: int) -> None:
        """Take the command that waits."""
        if self.slot:
            for loop, command in zip(self.loops, self.slot.pop(), strict=True):
                loop.take(command, time_ns)

    def end_stride(self, cycles: int) -> None:
        """Keep the rhythm of the state topic."""
        self._updates += cycles

    def update(self, time_ns: int, period: float) -> None:
        """Command each PID's output."""
        self.begin_stride(time_ns)
        for loop in self.loops:
            setattr(loop.handle, self.target, loop.compute(period))
        if self._updates % STATE_EVERY == 0:
            self._tell(time_ns, period)
        self._updates += 1

    def state(self, time_ns: int, period: float) -> JointControllerState:
        """This cycle as the state topic shows it."""
        return self.loops[0].state(time_ns, period)


@register("effort_controllers/JointGroupPositionController", interface=EFFORT)
class PidGroupPositionController(PidPositionController):
    """The same for several joints, without a state topic."""

    command_kind = "float64_array"
    state_kind = None


@register("effort_controllers/JointVelocityController", interface=EFFORT)
class PidVelocityController(PidController):
    """effort = PID(velocity error); commands in rad/s or m/s."""

    def starting(self, time_ns: int) -> None:
        """Come to rest."""
        super().starting(time_ns)
        self._command = self._error = self._output = 0.0
        self._pid = self.pids["pid"]
        self._pid.reset()

    def update(self, time_ns: int, period: float) -> None:
        """Command the PID's output."""
        if self.slot:
            (self._command,) = self.slot.pop()
        handle = self.handles[0]
        self._error = self._command - handle.velocity
        self._output = self._pid.compute(self._error, period)
        setattr(handle, self.target, self._output)
        if self._updates % STATE_EVERY == 0:
            self._tell(time_ns, period)
        self._updates += 1

    def state(self, time_ns: int, period: float) -> JointControllerState:
        """This cycle as the state topic shows it; process_value_dot stays 0."""
        gains = self._pid.gains
        return JointControllerState(
            time_ns, self._command, self.handles[0].velocity, 0.0, self._error, period,
            self._output, gains.p, gains.i, gains.d, gains.i_max, gains.antiwindup,
        )
