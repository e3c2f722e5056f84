"""ROS interface of trajectory controllers: message conversions, action server, query_state."""

from __future__ import annotations

from control_msgs.msg import (
    FollowJointTrajectoryAction,
    FollowJointTrajectoryFeedback,
    FollowJointTrajectoryGoal,
    FollowJointTrajectoryResult,
    JointTrajectoryControllerState,
)
from control_msgs.msg import JointTolerance as ToleranceMessage
from control_msgs.srv import QueryTrajectoryState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from aras_sim_bridge.control.controllers.action_controller import GoalHandle
from aras_sim_bridge.control.controllers.joint_trajectory_controller import (
    JointTrajectoryController,
)
from aras_sim_bridge.control.controllers.trajectory_types import (
    JointTolerance,
    StatePoint,
    Trajectory,
    TrajectoryControllerState,
    TrajectoryGoal,
    TrajectoryPoint,
)
from aras_sim_bridge.ros.control.controller_action_server import ControllerActionServer
from aras_sim_bridge.ros.conversions import from_time, to_duration, to_time
from aras_sim_bridge.ros.runtime.services import Fields, ServiceTable, service_handler
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.simulation import Simulation

StateMessage = JointTrajectoryControllerState | FollowJointTrajectoryFeedback


def from_trajectory(message: JointTrajectory) -> Trajectory:
    """Return the trajectory of a JointTrajectory message."""
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


def fill_state(message: StateMessage, state: TrajectoryControllerState) -> StateMessage:
    """Write a TrajectoryControllerState to a state or feedback message and return the message."""
    message.header.stamp = to_time(state.stamp_ns)
    message.joint_names = list(state.joint_names)
    for name in ("desired", "actual", "error"):
        point: StatePoint = getattr(state, name)
        to_fill: JointTrajectoryPoint = getattr(message, name)
        to_fill.positions, to_fill.velocities = point.positions, point.velocities
        to_fill.accelerations = point.accelerations
        to_fill.time_from_start = to_duration(point.time_from_start)
    return message


class TrajectoryActionServer(ControllerActionServer):
    """Action follow_joint_trajectory and service query_state of one trajectory controller."""

    action, topic = FollowJointTrajectoryAction, "follow_joint_trajectory"

    def __init__(
        self, controller: JointTrajectoryController, namespace: str, thread: SimulationThread
    ) -> None:
        """Advertise the action and the service of `controller` in `namespace`."""
        super().__init__(controller, namespace, thread)
        self._services = ServiceTable(namespace, thread, self.query_state)

    def shutdown(self) -> None:
        """Shut down the action and the service."""
        super().shutdown()
        self._services.shutdown()

    def make_goal(self, message: FollowJointTrajectoryGoal) -> TrajectoryGoal:
        """Convert a goal message to a goal of the controller."""
        return TrajectoryGoal(
            from_trajectory(message.trajectory),
            _read_tolerances(message.path_tolerance),
            _read_tolerances(message.goal_tolerance),
            message.goal_time_tolerance.to_sec(),
        )

    def make_result(self, handle: GoalHandle) -> tuple[FollowJointTrajectoryResult, str]:
        """Return the result message and status text of a finished goal."""
        code, text = int(handle.result.error_code), handle.result.error_string
        return FollowJointTrajectoryResult(code, text), text

    def make_feedback(self, state: TrajectoryControllerState) -> FollowJointTrajectoryFeedback:
        """Return the feedback message of a controller state."""
        return fill_state(FollowJointTrajectoryFeedback(), state)

    @service_handler(QueryTrajectoryState, call_fails=True)
    def query_state(self, _simulation: Simulation, request: QueryTrajectoryState) -> Fields:
        """Return the desired joint state of the trajectory at the requested time."""
        point = self._controller.query_state(from_time(request.time))
        return {
            "name": list(self._controller.joints),
            "position": point.positions,
            "velocity": point.velocities,
            "acceleration": point.accelerations,
        }


def _read_tolerances(messages: list[ToleranceMessage]) -> list[JointTolerance]:
    return [JointTolerance(m.name, m.position, m.velocity, m.acceleration) for m in messages]
