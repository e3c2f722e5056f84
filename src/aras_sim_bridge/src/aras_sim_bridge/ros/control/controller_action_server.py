"""Base class of the controllers' action servers, and the server of the grippers.

The server of the trajectories is in trajectory.py.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from typing import ClassVar

from actionlib.action_server import ActionServer
from actionlib.server_goal_handle import ServerGoalHandle
from control_msgs.msg import GripperCommandAction, GripperCommandGoal, GripperCommandResult
from genpy import Message

from aras_sim_bridge.control.controllers.action_controller import (
    PREEMPTED,
    REJECTED,
    SUCCEEDED,
    GoalHandle,
)
from aras_sim_bridge.control.controllers.gripper import GripperActionController, GripperGoal
from aras_sim_bridge.control.controllers.joint_trajectory_controller import (
    JointTrajectoryController,
)
from aras_sim_bridge.ros.conversions import to_time
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread


class _SimTimeActionServer(ActionServer):
    """Server of actionlib whose messages are stamped with simulated time.

    The server itself decides by wall time when to remove old goals from its status messages.
    """

    def __init__(self, *args: object, thread: SimulationThread) -> None:
        self._thread = thread
        super().__init__(*args, auto_start=False)

    def initialize(self) -> None:
        """Advertise the topics; the stamps that actionlib sets from rospy's clock are replaced."""
        super().initialize()
        for publisher in (self.status_pub, self.result_pub, self.feedback_pub):
            publisher.publish = partial(self._stamp_and_publish, publisher.publish)

    def _stamp_and_publish(self, publish: Callable[[Message], None], message: Message) -> None:
        message.header.stamp = to_time(self._thread.now_ns())
        publish(message)


class ControllerActionServer(ABC):
    """Base class of the action server of one controller.

    The callbacks post goals and cancel requests to the simulation thread without waiting. Waiting
    would cause a deadlock: actionlib locks the server during a callback, and the simulation thread
    needs this lock to publish feedback.
    """

    action: ClassVar[type[Message]]
    topic: ClassVar[str]

    def __init__(self, controller: JointTrajectoryController | GripperActionController,
                 namespace: str, thread: SimulationThread) -> None:
        """Start the action server `namespace`/`topic` for `controller`.

        A subclass defines the class attributes `action`, which is the message type of the action,
        and `topic`, which is the last part of its name. Its methods `make_goal`, `make_result` and
        `make_feedback` convert between the messages and the types of the controller.
        """
        self._controller = controller
        # goals by their ids; used in the simulation thread only
        self._goals: dict[str, GoalHandle] = {}
        self._server = _SimTimeActionServer(
            f"{namespace}/{self.topic}",
            self.action,
            lambda goal: thread.post(lambda: self._start_goal(goal)),
            lambda goal: thread.post(lambda: self._cancel_goal(goal)),
            thread=thread,
        )
        self._server.start()

    def shutdown(self) -> None:
        """Shut down the action server."""
        self._server.stop()

    @abstractmethod
    def make_goal(self, message: Message) -> object:
        """Convert a goal message to a goal of the controller."""

    @abstractmethod
    def make_result(self, handle: GoalHandle) -> tuple[Message, str]:
        """Return the result message and status text of a finished goal."""

    def make_feedback(self, state: object) -> Message:
        """Return the feedback message of a controller state, if the action has feedback."""
        raise NotImplementedError

    def _start_goal(self, goal: ServerGoalHandle) -> None:
        handle = self._controller.submit_goal(self.make_goal(goal.get_goal()))
        if handle.status == REJECTED:
            goal.set_rejected(*self.make_result(handle))
            return
        key = goal.get_goal_id().id
        self._goals[key] = handle
        goal.set_accepted()

        def publish_end(handle: GoalHandle) -> None:
            self._goals.pop(key, None)
            ends = {SUCCEEDED: goal.set_succeeded, PREEMPTED: goal.set_canceled}
            ends.get(handle.status, goal.set_aborted)(*self.make_result(handle))

        handle.on_feedback = lambda state: goal.publish_feedback(self.make_feedback(state))
        handle.on_done = publish_end

    def _cancel_goal(self, goal: ServerGoalHandle) -> None:
        handle = self._goals.get(goal.get_goal_id().id)
        if handle is not None:
            self._controller.cancel_goal(handle)


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
