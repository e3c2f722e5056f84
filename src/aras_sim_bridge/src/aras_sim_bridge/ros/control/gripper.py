"""Action server of gripper controllers."""

from control_msgs.msg import GripperCommandAction, GripperCommandGoal, GripperCommandResult

from aras_sim_bridge.control.controllers.action_controller import GoalHandle
from aras_sim_bridge.control.controllers.gripper import GripperGoal
from aras_sim_bridge.ros.control.controller_action_server import ControllerActionServer


class GripperActionServer(ControllerActionServer):
    """Action gripper_cmd of a gripper controller; as in ros_controllers, it has no feedback."""

    action, topic = GripperCommandAction, "gripper_cmd"

    def make_goal(self, message: GripperCommandGoal) -> GripperGoal:
        """Convert a goal message to a goal of the controller."""
        return GripperGoal(message.command.position, message.command.max_effort)

    def make_result(self, handle: GoalHandle) -> tuple[GripperCommandResult, str]:
        """Return the result message and status text of a finished goal."""
        result = handle.result
        message = GripperCommandResult(result.position, result.effort, result.stalled,
                                       result.reached_goal)
        return message, result.text
