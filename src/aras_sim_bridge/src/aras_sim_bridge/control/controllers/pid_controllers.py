"""PID controllers of single joints and of groups."""

from collections.abc import Mapping

from aras_sim_bridge.control.controllers.forward import JointCommandController
from aras_sim_bridge.control.controllers.joint_control_loop import POSITION_PID, SPEED_PID
from aras_sim_bridge.control.controllers.registry import register
from aras_sim_bridge.control.joints import EFFORT, VELOCITY
from aras_sim_bridge.control.pid import Pid
from aras_sim_bridge.errors import ControllerError
from aras_visual_servo_base.settings import read


class PidControllerBase(JointCommandController):
    """Base class of the PID controllers.

    The gains are parameters: `pid/...` for a single joint, `<joint>/pid/...` for a group (see
    Pid.from_parameters). A single-joint controller publishes its state.
    """

    state_kind = "joint_controller_state"

    def _make_loop_options(self, joint: str, parameters: Mapping) -> dict[str, Pid | bool]:
        """Read the PID gains of a joint. Raises ControllerError if one is missing."""
        return {"pid": self.read_pid(parameters, f"{joint}/pid" if self.is_group else "pid")}


@register("effort_controllers/JointPositionController", interface=EFFORT)
@register("velocity_controllers/JointPositionController", interface=VELOCITY)
class PidPositionController(PidControllerBase):
    """Command effort or velocity = PID(position error) to one joint.

    Set points (rad, m) are limited to the URDF's position limits. The hardware limits the output.
    The additional parameter `interpolate` is described in JointControlLoop.
    """

    loop_kind = POSITION_PID

    def _make_loop_options(self, joint: str, parameters: Mapping) -> dict[str, Pid | bool]:
        where = self.context.where
        interpolate = read(parameters, "interpolate", bool, where, ControllerError, False)
        return super()._make_loop_options(joint, parameters) | {"interpolate": interpolate}

    def restart(self, time_ns: int) -> None:
        """Reset the PIDs and move from the current positions to the last commands."""
        for loop in self.loops:
            loop.restart(time_ns)


@register("effort_controllers/JointGroupPositionController", interface=EFFORT)
class PidGroupPositionController(PidPositionController):
    """Position controllers of several joints, without a state topic."""

    command_kind = "float64_array"
    state_kind = None


@register("effort_controllers/JointVelocityController", interface=EFFORT)
class PidVelocityController(PidControllerBase):
    """Command effort = PID(velocity error) to one joint; set points are in rad/s or m/s."""

    loop_kind = SPEED_PID
