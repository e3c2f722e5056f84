"""The faces of trajectory controllers: message conversions, action server, query_state."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import rospy
from actionlib.action_server import ActionServer
from actionlib_msgs.msg import GoalStatusArray
from control_msgs.msg import (
    FollowJointTrajectoryAction,
    FollowJointTrajectoryFeedback,
    FollowJointTrajectoryResult,
    JointTrajectoryControllerState,
)
from control_msgs.srv import QueryTrajectoryState, QueryTrajectoryStateResponse
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from aras_sim_bridge.control.controllers.trajectory_types import (
    PREEMPTED,
    REJECTED,
    SUCCEEDED,
    JointTolerance,
    Trajectory,
    TrajectoryGoal,
    TrajectoryPoint,
)
from aras_sim_bridge.ros.conversions import from_time, to_duration, to_time
from aras_sim_bridge.ros.services import ServiceTable


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


def fill_state(message: Any, state: Any) -> Any:
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


def to_state(state: Any) -> JointTrajectoryControllerState:
    """Return the message of the controller's state topic."""
    return fill_state(JointTrajectoryControllerState(), state)


class _SimTimeActionServer(ActionServer):
    """actionlib's server with stamps of simulated time; its timer runs on wall time."""

    def __init__(self, *args: Any, now_ns: Callable[[], int]) -> None:
        self._now_ns = now_ns
        super().__init__(*args, auto_start=False)

    def publish_result(self, status: Any, result: Any) -> None:
        with self.lock:
            message = self.ActionResult(status=status, result=result)
            message.header.stamp = to_time(self._now_ns())
            self._send(self.result_pub, message)
            self.publish_status()

    def publish_feedback(self, status: Any, feedback: Any) -> None:
        with self.lock:
            message = self.ActionFeedback(status=status, feedback=feedback)
            message.header.stamp = to_time(self._now_ns())
            self._send(self.feedback_pub, message)

    def publish_status(self) -> None:
        with self.lock:
            now = rospy.Time.now()
            self.status_list = [
                tracker
                for tracker in self.status_list
                if tracker.handle_destruction_time == rospy.Time()
                or tracker.handle_destruction_time + self.status_list_timeout >= now
            ]
            message = GoalStatusArray(status_list=[t.status for t in self.status_list])
            message.header.stamp = to_time(self._now_ns())
            self._send(self.status_pub, message)

    @staticmethod
    def _send(publisher: rospy.Publisher, message: Any) -> None:
        if not rospy.is_shutdown():
            publisher.publish(message)


class TrajectoryAction:
    """follow_joint_trajectory and query_state of one trajectory controller."""

    def __init__(self, controller: Any, namespace: str, now_ns: Callable[[], int]) -> None:
        """Serve `controller` below its `namespace`; `now_ns` gives the simulated time."""
        self._controller = controller
        self._goals: dict[str, Any] = {}
        self._server = _SimTimeActionServer(
            f"{namespace}/follow_joint_trajectory",
            FollowJointTrajectoryAction,
            self._on_goal,
            self._on_cancel,
            now_ns=now_ns,
        )
        self._server.start()
        self._services = ServiceTable(namespace)
        self._services.add(
            "query_state", QueryTrajectoryState, self._query, lambda text: None, call_fails=True
        )

    def shutdown(self) -> None:
        """Take action and service off the graph."""
        self._server.stop()
        self._services.shutdown()

    def _on_goal(self, goal: Any) -> None:
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

        def feedback(state: Any) -> None:
            goal.publish_feedback(fill_state(FollowJointTrajectoryFeedback(), state))

        def done(ended: Any) -> None:
            self._goals.pop(key, None)
            ends = {SUCCEEDED: goal.set_succeeded, PREEMPTED: goal.set_canceled}
            end = ends.get(ended.status, goal.set_aborted)
            end(_result(ended), ended.result.error_string)

        handle.on_feedback = feedback
        handle.on_done = done

    def _on_cancel(self, goal: Any) -> None:
        handle = self._goals.get(goal.get_goal_id().id)
        if handle is not None:
            self._controller.cancel_goal(handle)

    def _query(self, request: QueryTrajectoryState) -> QueryTrajectoryStateResponse:
        point = self._controller.query_state(from_time(request.time))
        return QueryTrajectoryStateResponse(
            list(self._controller.joints), point.positions, point.velocities, point.accelerations
        )


def _tolerances(messages: Any) -> list[JointTolerance]:
    return [JointTolerance(m.name, m.position, m.velocity, m.acceleration) for m in messages]


def _result(handle: Any) -> FollowJointTrajectoryResult:
    return FollowJointTrajectoryResult(int(handle.result.error_code), handle.result.error_string)
