"""Base class of the joint trajectory controllers, with the semantics of ros_controllers.

The controllers follow spline trajectories from a topic or an action. The controller's own clock,
`uptime`, is the sum of the control periods, so a reset of the simulated clock does not lose the
trajectory.
"""

import logging
from collections.abc import Mapping
from functools import partial

from aras_sim_bridge import angles
from aras_sim_bridge.control.controllers.action_controller import (
    ABORTED,
    PREEMPTED,
    REJECTED,
    SUCCEEDED,
    ActionController,
    GoalHandle,
)
from aras_sim_bridge.control.controllers.base import ControllerContext, read_joint_names
from aras_sim_bridge.control.controllers.splines import SplineSegment, Waypoint
from aras_sim_bridge.control.controllers.trajectory_segments import (
    JointSegments,
    SegmentTolerances,
    check_points,
    find_joint_columns,
    find_segment,
    plan_segments,
)
from aras_sim_bridge.control.controllers.trajectory_types import (
    ErrorCode,
    InvalidTrajectoryError,
    StatePoint,
    Trajectory,
    TrajectoryControllerState,
    TrajectoryGoal,
    TrajectoryResult,
)
from aras_sim_bridge.control.hardware import RobotHardware
from aras_sim_bridge.errors import ControllerError
from aras_visual_servo_base.settings import read

log = logging.getLogger(__name__)

_NS_PER_S = 1_000_000_000


class _Timer:
    """Timer with an exact average rate: if last + 1/rate < now, it fires and last += 1/rate."""

    def __init__(self, rate: float) -> None:
        self._step_ns = _NS_PER_S / rate if rate > 0.0 else 0.0

    def start(self, now_ns: int) -> None:
        self._last_ns = float(now_ns)

    def is_due(self, now_ns: int) -> bool:
        if self._step_ns == 0.0 or not self._last_ns + self._step_ns < now_ns:
            return False
        self._last_ns += self._step_ns
        return True


class JointTrajectoryController(ActionController):
    """Base class of the trajectory controllers for the position, velocity and effort interfaces.

    `set_command` uses a trajectory immediately, because all methods are called in the simulation
    thread.
    """

    command_kind = "joint_trajectory"
    state_kind = "joint_trajectory_state"
    action_kind = "follow_joint_trajectory"

    def init(
        self, hardware: RobotHardware, parameters: Mapping, context: ControllerContext
    ) -> None:
        """Read the parameters. Raises ControllerError if a joint, gain or parameter is invalid."""
        super().init(hardware, parameters, context)
        where = context.where
        joints = read_joint_names(parameters, "joints", where)
        self._handles = [self.take_handle(hardware, joint) for joint in joints]
        self.joints = joints
        self._wraps = [handle.kind == "continuous" for handle in self._handles]
        given = partial(read, parameters, where=where, fault=ControllerError)
        self._allows_partial_goals = given("allow_partial_joints_goal", bool, default=False)
        stop = given("stop_trajectory_duration", float, default=0.0)
        if stop < 0.0:
            raise ControllerError(f"parameter {where}/stop_trajectory_duration is negative: {stop}")
        self._stop_ns = round(stop * _NS_PER_S)
        self._state_timer = _Timer(given("state_publish_rate", float, default=50.0))
        self._feedback_timer = _Timer(given("action_monitor_rate", float, default=20.0))
        self._tolerances = SegmentTolerances.from_parameters(
            given("constraints", Mapping, default={}), f"{where}/constraints", joints
        )
        self._init_output(parameters)
        self._segments: list[JointSegments] = []
        self._arrived_joints: set[int] = set()
        self._reset_measurements(0)

    def _reset_measurements(self, time_ns: int) -> None:
        """Reset the clocks and set desired, actual and error states to zero."""
        self._time_ns, self._uptime_ns, self._period_ns = time_ns, 0, 0
        self._desired, self._actual, self._errors = (
            [[0.0] * len(self.joints) for _ in range(orders)] for orders in (3, 2, 2)
        )

    def starting(self, time_ns: int) -> None:
        """Hold the measured position."""
        super().starting(time_ns)
        self._running = False
        self._reset_measurements(time_ns)
        self._state_timer.start(0)
        self._hold_position()
        self._desired[0] = [handle.position for handle in self._handles]
        self._start_output()
        self._running = True
        self._preempt_goal("controller restarted")

    def update(self, time_ns: int, period: float) -> None:
        """Sample the trajectory, check the tolerances and write the commands."""
        self._time_ns = time_ns
        self._period_ns = round(period * _NS_PER_S)
        self._uptime_ns = now_ns = self._uptime_ns + self._period_ns
        active = self._goal
        first = self._sample(now_ns)
        self._command(period)
        feedback = active is not None and self._feedback_timer.is_due(now_ns)
        listener = self.on_state if self._state_timer.is_due(now_ns) else None
        state = self._make_state(first, now_ns) if listener is not None or feedback else None
        if listener is not None:
            listener(state)
        if feedback and active.on_feedback is not None:
            active.on_feedback(state)
        # A listener may have replaced the goal.
        if active is not None and active is self._goal:
            self._check_goal(now_ns)

    def _sample(self, now_ns: int) -> SplineSegment:
        """Update desired, actual and error states; return the first joint's current segment."""
        desired, actual, errors = self._desired, self._actual, self._errors
        present = self._segment_indices
        for k, handle in enumerate(self._handles):
            segments = self._segments[k]
            index = present[k]
            while index + 1 < len(segments) and segments[index + 1].start_ns <= now_ns:
                index += 1
            present[k] = index
            position, velocity, acceleration = segments[index].sample(now_ns)
            desired[0][k], desired[1][k], desired[2][k] = position, velocity, acceleration
            actual[0][k], actual[1][k] = handle.position, handle.velocity
            errors[0][k] = angles.shortest_angular_distance(handle.position, position)
            errors[1][k] = velocity - handle.velocity
        return self._segments[0][present[0]]

    def _check_goal(self, now_ns: int) -> None:
        """End the active goal if it is reached or violates a tolerance."""
        errors = self._errors
        for k in range(len(self.joints)):
            segments, index = self._segments[k], self._segment_indices[k]
            segment = segments[index]
            if segment.goal is not self._goal:
                continue
            name, error = self.joints[k], errors[0][k]
            # Check the goal only after the end of the last segment. Before, the desired velocity
            # may not be 0 yet, as on a straight line.
            if now_ns <= segment.end_ns:
                if not segment.path_tolerance.is_met(error, errors[1][k]):
                    code, text = ErrorCode.PATH_TOLERANCE_VIOLATED, f"{name} path error {error:f}"
                    self._end_goal(ABORTED, TrajectoryResult(code, text))
                    return
            elif index == len(segments) - 1:
                if segment.goal_tolerance.is_met(error, errors[1][k]):
                    self._arrived_joints.add(k)
                elif (
                    k not in self._arrived_joints
                    and now_ns >= segment.end_ns + segment.goal_time_ns
                ):
                    code, text = ErrorCode.GOAL_TOLERANCE_VIOLATED, f"{name} goal error {error:f}"
                    self._end_goal(ABORTED, TrajectoryResult(code, text))
                    return
        if len(self._arrived_joints) == len(self.joints):
            self._end_goal(SUCCEEDED, TrajectoryResult(ErrorCode.SUCCESSFUL))

    def _make_state(self, segment: SplineSegment, now_ns: int) -> TrajectoryControllerState:
        elapsed = max(now_ns - segment.start_ns, 0) / _NS_PER_S
        begin = segment.time_from_start
        desired, actual, errors = self._desired, self._actual, self._errors
        return TrajectoryControllerState(
            self._time_ns,
            self.joints,
            StatePoint(list(desired[0]), list(desired[1]), list(desired[2]), begin),
            StatePoint(list(actual[0]), list(actual[1]), [], begin + elapsed),
            StatePoint(list(errors[0]), list(errors[1]), [], elapsed),
        )

    def set_command(self, value: Trajectory) -> None:
        """Follow a trajectory without a goal; a trajectory without points stops the joints.

        An active goal is preempted.

        Raises:
            InvalidTrajectoryError: the trajectory cannot be followed; the current one continues.
        """
        self._accept_trajectory(value, None)
        self._preempt_goal("preempted by a command")

    def submit_goal(self, goal: TrajectoryGoal) -> GoalHandle:
        """Start an action goal, which replaces the previous one.

        Returns:
            The handle: active, or rejected with the reason in its result.
        """
        handle = GoalHandle(goal)
        try:
            self._accept_trajectory(goal.trajectory, handle)
        except InvalidTrajectoryError as error:
            handle.finish(REJECTED, TrajectoryResult(error.code, str(error)))
        else:
            self._arrived_joints = set()
            self._feedback_timer.start(self._uptime_ns)
            self._preempt_goal("preempted by a new goal", handle)
        return handle

    def query_state(self, time_ns: int) -> StatePoint:
        """Return the desired state at a simulated time, in the controller's joint order.

        Raises:
            ControllerError: the controller is not running, or the time precedes the trajectory.
        """
        if not self._running:
            raise ControllerError(
                f"controller '{self.context.name}' is not running; start it first"
            )
        at_ns = self._uptime_ns + time_ns - self._time_ns
        samples = []
        for segments in self._segments:
            index = find_segment(segments, at_ns)
            if index < 0:
                raise ControllerError(
                    f"controller '{self.context.name}': time {time_ns / _NS_PER_S:.3f} s "
                    f"precedes the trajectory; ask for a later time"
                )
            samples.append(segments[index].sample(at_ns))
        return StatePoint(*(list(values) for values in zip(*samples, strict=True)))

    def _accept_trajectory(self, trajectory: Trajectory, goal: GoalHandle | None) -> None:
        """Follow `trajectory` from now on.

        Raises:
            InvalidTrajectoryError: the trajectory cannot be followed; the current one continues.
        """
        name = self.context.name
        if not self._running:
            raise InvalidTrajectoryError(f"controller '{name}' is not running; start it first")
        tolerances = self._tolerances
        try:
            if goal is not None:
                tolerances = tolerances.override(goal.goal, self.joints)
            # A command without points needs no joint names, because it only stops the joints.
            if goal is not None or len(trajectory.points):
                columns = find_joint_columns(
                    trajectory.joint_names, self.joints, self._allows_partial_goals
                )
            if not len(trajectory.points):
                self._hold_position(goal, tolerances)
                return
            check_points(trajectory)
            next_ns = self._uptime_ns + self._period_ns
            start_ns = next_ns
            if trajectory.stamp_ns:
                start_ns = self._uptime_ns + trajectory.stamp_ns - self._time_ns
            segments, dropped = plan_segments(
                trajectory, columns, self._segments, self._wraps, next_ns, start_ns, goal,
                tolerances,
            )
        except InvalidTrajectoryError as error:
            raise InvalidTrajectoryError(f"controller '{name}': {error}", error.code) from None
        silent = dropped == 1 and not trajectory.stamp_ns
        if dropped and not (silent and trajectory.points[0].time_from_start_ns == 0):
            log.warning(
                f"controller '{name}': {dropped} of {len(trajectory.points)} trajectory points "
                f"are in the past and were dropped; check the header stamp and time_from_start"
            )
        self._follow(segments)

    def _follow(self, segments: list[JointSegments]) -> None:
        self._segments = segments
        self._segment_indices = [0] * len(segments)

    def _hold_position(
        self, goal: GoalHandle | None = None, tolerances: SegmentTolerances | None = None
    ) -> None:
        """Hold the measured position, or brake within stop_trajectory_duration if that is not 0."""
        now_ns, result = self._uptime_ns, []
        for k, handle in enumerate(self._handles):
            if self._stop_ns == 0 or not self._running:
                rest = Waypoint(handle.position, 0.0, 0.0)
                segment = SplineSegment(now_ns, rest, now_ns, rest)
            else:
                segment = self._plan_braking(now_ns, self._desired[0][k], self._desired[1][k])
            if goal is not None:
                tolerances.apply_to(segment, goal, k)
            result.append([segment])
        self._follow(result)

    def _plan_braking(self, now_ns: int, position: float, velocity: float) -> SplineSegment:
        """Return a segment that brings one joint to rest within stop_trajectory_duration.

        It is the first half of a spline that starts at the desired `position` and `velocity`, and
        returns to this position with the opposite velocity after twice stop_trajectory_duration.
        By symmetry, the joint is at rest in the middle.
        """
        begin = Waypoint(position, velocity, 0.0)
        mirror = Waypoint(position, -velocity, 0.0)
        half_ns = now_ns + self._stop_ns
        there_and_back = SplineSegment(now_ns, begin, now_ns + 2 * self._stop_ns, mirror)
        return SplineSegment(now_ns, begin, half_ns, Waypoint(*there_and_back.sample(half_ns)))

    def _preempt_goal(self, reason: str, next_goal: GoalHandle | None = None) -> None:
        self._end_goal(PREEMPTED, TrajectoryResult(ErrorCode.SUCCESSFUL, reason), next_goal)
