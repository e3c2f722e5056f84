"""The action of gripper controllers."""

from control_msgs.msg import GripperCommandAction, GripperCommandGoal, GripperCommandResult

from aras_sim_bridge.control.controllers.goals import GoalHandle
from aras_sim_bridge.control.controllers.gripper import GripperGoal
from aras_sim_bridge.ros.control.actions import ControllerAction


class GripperAction(ControllerAction):
    """gripper_cmd of one gripper controller; it tells no feedback, as upstream's."""

    action, topic = GripperCommandAction, "gripper_cmd"

    def _make_goal(self, message: GripperCommandGoal) -> GripperGoal:
        return GripperGoal(message.command.position, message.command.max_effort)

    def _make_result(self, handle: GoalHandle) -> tuple[GripperCommandResult, str]:
        found = handle.result
        told = GripperCommandResult(found.position, found.effort, found.stalled,
                                    found.reached_goal)
        return told, found.text
