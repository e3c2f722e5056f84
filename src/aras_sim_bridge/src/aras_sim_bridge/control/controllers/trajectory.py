"""JointTrajectoryController for position, effort and velocity joints."""

from collections.abc import Callable, Mapping

from aras_sim_bridge import parameters as params
from aras_sim_bridge.control.controllers.registry import register
from aras_sim_bridge.control.controllers.trajectory_core import JointTrajectoryController
from aras_sim_bridge.control.joints import EFFORT, POSITION, VELOCITY, JointHandle
from aras_sim_bridge.control.pid import Pid


@register("position_controllers/JointTrajectoryController")
class PositionTrajectoryController(JointTrajectoryController):
    """Commands the desired positions."""

    interface = POSITION

    def _start_output(self, handles: list[JointHandle]) -> None:
        for handle in handles:
            handle.position_command = handle.position

    def _command(self, period: float) -> None:
        for handle, position in zip(self._handles, self._desired[0], strict=True):
            handle.position_command = position


class _ClosedLoopTrajectoryController(JointTrajectoryController):
    """velocity_ff · desired velocity + PID(position error, velocity error)."""

    _write: Callable[[JointHandle, float], None]

    def _init_output(self, parameters: Mapping, where: str) -> None:
        gains = params.section(parameters, "gains", where)
        forward = params.section(parameters, "velocity_ff", where)
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

    def _start_output(self, handles: list[JointHandle]) -> None:
        for handle, pid, _ in self._loops:
            pid.reset()
            self._write(handle, 0.0)

    def _command(self, period: float) -> None:
        position_errors, velocity_errors = self._errors
        velocities = self._desired[1]
        for k, (handle, pid, forward) in enumerate(self._loops):
            output = pid.compute_with_derivative(position_errors[k], velocity_errors[k], period)
            self._write(handle, forward * velocities[k] + output)


@register("effort_controllers/JointTrajectoryController")
class EffortTrajectoryController(_ClosedLoopTrajectoryController):
    """The closed loop's output is an effort."""

    interface = EFFORT

    @staticmethod
    def _write(handle: JointHandle, value: float) -> None:
        handle.effort_command = value


@register("velocity_controllers/JointTrajectoryController")
class VelocityTrajectoryController(_ClosedLoopTrajectoryController):
    """The closed loop's output is a velocity."""

    interface = VELOCITY

    @staticmethod
    def _write(handle: JointHandle, value: float) -> None:
        handle.velocity_command = value
