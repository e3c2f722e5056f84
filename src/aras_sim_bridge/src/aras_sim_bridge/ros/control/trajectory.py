"""The faces of trajectory controllers: message conversions, action server, query_state."""

from __future__ import annotations

import rospy
from actionlib.action_server import ActionServer
from actionlib.server_goal_handle import ServerGoalHandle
from actionlib_msgs.msg import GoalStatus, GoalStatusArray
from control_msgs.msg import (
    FollowJointTrajectoryAction,
    FollowJointTrajectoryFeedback,
    FollowJointTrajectoryResult,
    JointTrajectoryControllerState,
)
from control_msgs.msg import JointTolerance as ToleranceMessage
from control_msgs.srv import QueryTrajectoryState
from genpy import Message
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from aras_sim_bridge.control.controllers.trajectory_core import JointTrajectoryController
from aras_sim_bridge.control.controllers.trajectory_types import (
    PREEMPTED,
    REJECTED,
    SUCCEEDED,
    GoalHandle,
    JointTolerance,
    Trajectory,
    TrajectoryGoal,
    TrajectoryPoint,
    TrajectoryState,
)
from aras_sim_bridge.ros.conversions import from_time, to_duration, to_time
from aras_sim_bridge.ros.runtime.services import Fields, ServiceTable, serves
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.simulation import Simulation

StateMessage = JointTrajectoryControllerState | FollowJointTrajectoryFeedback


def from_trajectory(message: JointTrajectory) -> Trajectory:
    """Return the trajectory of a message."""
    points = [
        TrajectoryPoint(
            from_time(point.time_from_start),
            point.positions,
            point.velocities,
            point.accelerations,
        )
        for point in message.points
    ]
    return Trajectory(message.joint_names, points, from_time(message.header.stamp))


def fill_state(message: StateMessage, state: TrajectoryState) -> StateMessage:
    """Write a TrajectoryState into a state or feedback message; returns the message."""
    message.header.stamp = to_time(state.stamp_ns)
    message.joint_names = list(state.joint_names)
    for name in ("desired", "actual", "error"):
        point = getattr(state, name)
        setattr(
            message,
            name,
            JointTrajectoryPoint(
                positions=point.positions,
                velocities=point.velocities,
                accelerations=point.accelerations,
                time_from_start=to_duration(point.time_from_start),
            ),
        )
    return message


class _SimTimeActionServer(ActionServer):
    """actionlib's server with stamps of simulated time; its timer runs on wall time."""

    def __init__(self, *args: object, thread: SimulationThread) -> None:
        self._thread = thread
        super().__init__(*args, auto_start=False)

    def publish_result(self, status: GoalStatus, result: Message) -> None:
        with self.lock:
            self._send(self.result_pub, self.ActionResult(status=status, result=result))
            self.publish_status()

    def publish_feedback(self, status: GoalStatus, feedback: Message) -> None:
        with self.lock:
            self._send(self.feedback_pub, self.ActionFeedback(status=status, feedback=feedback))

    def publish_status(self) -> None:
        with self.lock:
            now = rospy.Time.now()
            self.status_list = [
                tracker
                for tracker in self.status_list
                if tracker.handle_destruction_time == rospy.Time()
                or tracker.handle_destruction_time + self.status_list_timeout >= now
            ]
            statuses = [tracker.status for tracker in self.status_list]
            self._send(self.status_pub, GoalStatusArray(status_list=statuses))

    def _send(self, publisher: rospy.Publisher, message: Message) -> None:
        message.header.stamp = to_time(self._thread.now_ns())
        if not rospy.is_shutdown():
            publisher.publish(message)


class TrajectoryAction:
    """follow_joint_trajectory and query_state of one trajectory controller.

    Goals and cancels are posted, never waited for: actionlib calls with its lock held, which the
    simulation's thread needs to tell of a goal's progress.
    """

    def __init__(
        self, controller: JointTrajectoryController, namespace: str, thread: SimulationThread
    ) -> None:
        """Serve `controller` below its `namespace`."""
        self._controller = controller
        self._goals: dict[str, GoalHandle] = {}  # the simulation's thread's
        self._server = _SimTimeActionServer(
            f"{namespace}/follow_joint_trajectory",
            FollowJointTrajectoryAction,
            lambda goal: thread.post(lambda: self._begin(goal)),
            lambda goal: thread.post(lambda: self._cancel(goal)),
            thread=thread,
        )
        self._server.start()
        self._services = ServiceTable(namespace, thread, self.query_state)

    def shutdown(self) -> None:
        """Take action and service off the graph."""
        self._server.stop()
        self._services.shutdown()

    def _begin(self, goal: ServerGoalHandle) -> None:
        message = goal.get_goal()
        request = TrajectoryGoal(
            from_trajectory(message.trajectory),
            _tolerances(message.path_tolerance),
            _tolerances(message.goal_tolerance),
            message.goal_time_tolerance.to_sec(),
        )
        handle = self._controller.submit_goal(request)
        if handle.status == REJECTED:
            goal.set_rejected(_result(handle), handle.result.error_string)
            return
        key = goal.get_goal_id().id
        self._goals[key] = handle
        goal.set_accepted()

        def feedback(state: TrajectoryState) -> None:
            goal.publish_feedback(fill_state(FollowJointTrajectoryFeedback(), state))

        def done(ended: GoalHandle) -> None:
            self._goals.pop(key, None)
            ends = {SUCCEEDED: goal.set_succeeded, PREEMPTED: goal.set_canceled}
            end = ends.get(ended.status, goal.set_aborted)
            end(_result(ended), ended.result.error_string)

        handle.on_feedback = feedback
        handle.on_done = done

    def _cancel(self, goal: ServerGoalHandle) -> None:
        handle = self._goals.get(goal.get_goal_id().id)
        if handle is not None:
            self._controller.cancel_goal(handle)

    @serves(QueryTrajectoryState, call_fails=True)
    def query_state(self, _simulation: Simulation, request: QueryTrajectoryState) -> Fields:
        """Where the trajectory wants the joints to be at a time."""
        point = self._controller.query_state(from_time(request.time))
        return {
            "name": list(self._controller.joints),
            "position": point.positions,
            "velocity": point.velocities,
            "acceleration": point.accelerations,
        }


def _tolerances(messages: list[ToleranceMessage]) -> list[JointTolerance]:
    return [JointTolerance(m.name, m.position, m.velocity, m.acceleration) for m in messages]


def _result(handle: GoalHandle) -> FollowJointTrajectoryResult:
    return FollowJointTrajectoryResult(int(handle.result.error_code), handle.result.error_string)
