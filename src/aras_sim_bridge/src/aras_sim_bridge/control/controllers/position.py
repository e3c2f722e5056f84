"""position_controllers: commands are positions (rad or m), reached by the simulated joint."""

from aras_sim_bridge.control.controllers.forward import ForwardController
from aras_sim_bridge.control.controllers.registry import register
from aras_sim_bridge.control.joints import POSITION


@register("position_controllers/JointPositionController")
class PositionJointPositionController(ForwardController):
    """Hands a position on; its limits are the handle's affair."""

    interface = POSITION
