"""effort_controllers for single joints: outputs are efforts (N m or N)."""

from aras_sim_bridge.control.controllers.forward import ForwardController
from aras_sim_bridge.control.controllers.pid_controllers import (
    PidPositionController,
    PidVelocityController,
)
from aras_sim_bridge.control.controllers.registry import register
from aras_sim_bridge.control.joints import EFFORT


@register("effort_controllers/JointEffortController")
class EffortJointEffortController(ForwardController):
    """Hands an effort on."""

    interface = EFFORT


@register("effort_controllers/JointPositionController")
class EffortJointPositionController(PidPositionController):
    """effort = PID(position error); not clamped here but by the limit handle."""

    interface = EFFORT


@register("effort_controllers/JointVelocityController")
class EffortJointVelocityController(PidVelocityController):
    """effort = PID(velocity error)."""

    interface = EFFORT
