"""effort_controllers: single-joint controllers that command efforts."""

from collections.abc import Mapping
from typing import Any

from aras_sim_bridge import parameters as params
from aras_sim_bridge.controllers.base import STATE_EVERY, Context, Controller, checked_number
from aras_sim_bridge.controllers.pid_loops import PositionLoop
from aras_sim_bridge.controllers.registry import register
from aras_sim_bridge.joints import EFFORT
from aras_sim_bridge.pid import Pid


@register("effort_controllers/JointPositionController")
class JointPositionController(Controller):
    """effort = PID(position error). Parameters: `joint`, `pid/...` (see Pid.from_parameters)."""

    interface = EFFORT
    command_kind = "float64"
    state_kind = "joint_controller_state"

    def init(self, hardware: Any, parameters: Mapping, context: Context) -> None:
        """Raises ControllerError for a missing joint, gain, or joint of that interface."""
        super().init(hardware, parameters, context)
        joint = params.name(parameters, "joint", context.where)
        where = f"{context.where}/pid"
        pid = Pid.from_parameters(params.section(parameters, "pid", context.where), where)
        handle = self.take_handle(hardware, joint)
        self.joints = (joint,)
        self.pids = {"pid": pid}
        self.handle = handle
        self.loop = PositionLoop(handle, pid, context.warn, context.name)
        self._updates = 0

    def starting(self, time_ns: int) -> None:
        """Hold the present position."""
        self.loop.start()

    def update(self, time_ns: int, period: float) -> None:
        """Command the PID's effort."""
        self.handle.effort_command = self.loop.compute(time_ns, period)
        if self._updates % STATE_EVERY == 0 and self.on_state is not None:
            self.on_state(self.loop.state(time_ns, period))
        self._updates += 1

    def set_command(self, value: float) -> None:
        """Position in rad or m. Raises ControllerError if it is not finite."""
        self.loop.command = checked_number(value, self.context.name)
