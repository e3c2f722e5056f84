"""velocity_controllers: outputs are velocities (rad/s or m/s)."""

from aras_sim_bridge.control.controllers.forward import ForwardController
from aras_sim_bridge.control.controllers.pid_controllers import PidPositionController
from aras_sim_bridge.control.controllers.registry import register
from aras_sim_bridge.control.joints import VELOCITY


@register("velocity_controllers/JointVelocityController")
class VelocityJointVelocityController(ForwardController):
    """Hands a velocity on."""

    interface = VELOCITY


@register("velocity_controllers/JointPositionController")
class VelocityJointPositionController(PidPositionController):
    """velocity = PID(position error)."""

    interface = VELOCITY
