"""JointTrajectoryController for position, effort and velocity joints."""

from collections.abc import Mapping

from aras_sim_bridge.control.controllers.joint_trajectory_controller import (
    JointTrajectoryController,
)
from aras_sim_bridge.control.controllers.registry import register
from aras_sim_bridge.control.joints import COMMAND_COLUMNS, EFFORT, POSITION, VELOCITY
from aras_sim_bridge.errors import ControllerError
from aras_visual_servo_base.settings import read


@register("position_controllers/JointTrajectoryController", interface=POSITION)
class PositionTrajectoryController(JointTrajectoryController):
    """Follow trajectories of several joints by commanding the desired positions."""

    def _start_output(self) -> None:
        for handle in self._handles:
            handle.position_command = handle.position

    def _command(self, period: float) -> None:
        for handle, position in zip(self._handles, self._desired[0], strict=True):
            handle.position_command = position


@register("effort_controllers/JointTrajectoryController", interface=EFFORT)
@register("velocity_controllers/JointTrajectoryController", interface=VELOCITY)
class ClosedLoopTrajectoryController(JointTrajectoryController):
    """Command velocity_ff · desired velocity + PID(position error, velocity error) to each joint.

    The command is an effort or a velocity, depending on the interface. velocity_ff is a parameter.
    """

    def _init_output(self, parameters: Mapping) -> None:
        where = self.context.where
        forward = read(parameters, "velocity_ff", Mapping, where, ControllerError, {})
        self._target = COMMAND_COLUMNS[self.interface]
        self._loops = []
        for handle in self._handles:
            pid = self.read_pid(parameters, f"gains/{handle.name}")
            factor = read(
                forward, handle.name, float, f"{where}/velocity_ff", ControllerError, 0.0
            )
            self._loops.append((handle, pid, factor))

    def get_loop_gains(self) -> dict[str, tuple[float, float]]:
        found = {handle.name: (pid.gains.p, pid.gains.d) for handle, pid, _ in self._loops}
        return found if self.interface == EFFORT else {}

    def _start_output(self) -> None:
        for handle, pid, _ in self._loops:
            pid.reset()
            handle.row[self._target] = 0.0

    def _command(self, period: float) -> None:
        position_errors, velocity_errors = self._errors
        velocities = self._desired[1]
        for k, (handle, pid, forward) in enumerate(self._loops):
            output = pid.compute(position_errors[k], period, velocity_errors[k])
            handle.row[self._target] = forward * velocities[k] + output
