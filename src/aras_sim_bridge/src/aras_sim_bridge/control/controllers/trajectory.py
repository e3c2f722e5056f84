"""JointTrajectoryController for position, effort and velocity joints."""

from collections.abc import Mapping

from aras_sim_bridge import parameters as params
from aras_sim_bridge.control.controllers.forward import COMMAND_OF
from aras_sim_bridge.control.controllers.registry import register
from aras_sim_bridge.control.controllers.trajectory_core import JointTrajectoryController
from aras_sim_bridge.control.joints import EFFORT, POSITION, VELOCITY
from aras_sim_bridge.control.pid import Pid


@register("position_controllers/JointTrajectoryController", interface=POSITION)
class PositionTrajectoryController(JointTrajectoryController):
    """Commands the desired positions."""

    def _start_output(self) -> None:
        for handle in self._handles:
            handle.position_command = handle.position

    def _command(self, period: float) -> None:
        for handle, position in zip(self._handles, self._desired[0], strict=True):
            handle.position_command = position


@register("effort_controllers/JointTrajectoryController", interface=EFFORT)
@register("velocity_controllers/JointTrajectoryController", interface=VELOCITY)
class ClosedLoopTrajectoryController(JointTrajectoryController):
    """effort or velocity = velocity_ff · desired velocity + PID(position error, velocity error)."""

    def _init_output(self, parameters: Mapping, where: str) -> None:
        gains = params.section(parameters, "gains", where)
        forward = params.section(parameters, "velocity_ff", where)
        self._target = COMMAND_OF[self.interface]
        self.pids = {
            f"gains/{joint}": Pid.from_parameters(
                params.section(gains, joint, f"{where}/gains"), f"{where}/gains/{joint}"
            )
            for joint in self.joints
        }
        self._loops = [
            (handle, pid, params.number(forward, handle.name, f"{where}/velocity_ff", 0.0))
            for handle, pid in zip(self._handles, self.pids.values(), strict=True)
        ]

    def _start_output(self) -> None:
        for handle, pid, _ in self._loops:
            pid.reset()
            setattr(handle, self._target, 0.0)

    def _command(self, period: float) -> None:
        position_errors, velocity_errors = self._errors
        velocities = self._desired[1]
        for k, (handle, pid, forward) in enumerate(self._loops):
            output = pid.compute(position_errors[k], period, velocity_errors[k])
            setattr(handle, self._target, forward * velocities[k] + output)
