"""Group controllers: one array of commands for several joints, no state topic."""

from collections.abc import Mapping, Sequence
from typing import Any

from aras_sim_bridge import parameters as params
from aras_sim_bridge.control.controllers.base import Context, Controller
from aras_sim_bridge.control.controllers.forward import ForwardGroupController, checked_numbers
from aras_sim_bridge.control.controllers.pid_loops import PositionLoop
from aras_sim_bridge.control.controllers.registry import register
from aras_sim_bridge.control.joints import EFFORT, POSITION, VELOCITY
from aras_sim_bridge.control.pid import Pid


@register("effort_controllers/JointGroupEffortController")
class GroupEffortController(ForwardGroupController):
    """Hands efforts on."""

    interface = EFFORT


@register("position_controllers/JointGroupPositionController")
class GroupPositionController(ForwardGroupController):
    """Hands positions on."""

    interface = POSITION


@register("velocity_controllers/JointGroupVelocityController")
class GroupVelocityController(ForwardGroupController):
    """Hands velocities on."""

    interface = VELOCITY


@register("effort_controllers/JointGroupPositionController")
class GroupEffortPositionController(Controller):
    """effort = PID(position error), joint by joint. Parameters: `joints`, `<joint>/pid/...`,
    `interpolate` (see PositionLoop).
    """

    interface = EFFORT
    command_kind = "float64_array"

    def init(self, hardware: Any, parameters: Mapping, context: Context) -> None:
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
