"""GripperActionController for position and effort joints."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from math import isfinite

from aras_sim_bridge.control.controllers.action_controller import (
    ABORTED,
    PREEMPTED,
    REJECTED,
    SUCCEEDED,
    ActionController,
    GoalHandle,
)
from aras_sim_bridge.control.controllers.base import ControllerContext
from aras_sim_bridge.control.controllers.registry import register
from aras_sim_bridge.control.hardware import RobotHardware
from aras_sim_bridge.control.joints import EFFORT, POSITION
from aras_sim_bridge.errors import ControllerError
from aras_visual_servo_base.settings import read

_NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True)
class GripperGoal:
    """Goal of a gripper: a position (rad or m) and the largest effort (N m or N).

    The effort has an effect only if the joint is driven by effort.
    """

    position: float
    max_effort: float = 0.0


@dataclass(frozen=True, slots=True)
class GripperResult:
    """State of a gripper when its goal ended.

    Attributes:
        position: measured position, rad or m.
        effort: effort of the last command, N m or N.
        stalled: whether the joint stopped before it reached the goal.
        text: reason why a goal was rejected.
    """

    position: float = 0.0
    effort: float = 0.0
    stalled: bool = False
    reached_goal: bool = False
    text: str = ""


class GripperActionController(ActionController):
    """Move a joint to the position of a goal, with the semantics of ros_controllers.

    The goal succeeds within `goal_tolerance` of its position. It is aborted if the joint is slower
    than `stall_velocity_threshold` for `stall_timeout`, for example because the fingers hold an
    object.

    Parameters, with their defaults:
        joint: name of the joint; required.
        goal_tolerance: 0.01 rad or m.
        max_effort: largest effort before the first goal and after a cancelled goal; 0 N m or N.
        stall_velocity_threshold: 0.001 rad/s or m/s.
        stall_timeout: 1 s.
    """

    action_kind = "gripper_command"

    def init(
        self, hardware: RobotHardware, parameters: Mapping, context: ControllerContext
    ) -> None:
        """Read joint, gains and parameters. Raises ControllerError if one is missing or invalid."""
        super().init(hardware, parameters, context)
        given = partial(read, parameters, where=context.where, fault=ControllerError)
        self._handle = self.take_handle(hardware, given("joint", str))
        self.joints = (self._handle.name,)
        self._tolerance = abs(given("goal_tolerance", float, default=0.01))
        self._default_effort = abs(given("max_effort", float, default=0.0))
        self._stall_velocity = given("stall_velocity_threshold", float, default=0.001)
        self._stall_timeout_ns = round(given("stall_timeout", float, default=1.0) * _NS_PER_S)
        self._init_output(parameters)
        self._desired = GripperGoal(0.0)

    def starting(self, time_ns: int) -> None:
        """Hold the measured position."""
        super().starting(time_ns)
        self._hold_position()
        self._effort = 0.0
        self._last_motion_ns: int | None = None
        self._start_output()
        self._running = True
        self._preempt_goal("controller restarted")

    def reset(self) -> None:
        """Restart the stall timer, because the clock was reset."""
        super().reset()
        self._last_motion_ns = None

    def update(self, time_ns: int, period: float) -> None:
        """End the goal if it is reached or the joint has stalled, and write the command."""
        if self._goal is not None:
            self._check_goal(time_ns)
        self._effort = self._command(period)

    def _check_goal(self, time_ns: int) -> None:
        """End the active goal if it is reached or the joint has stalled."""
        position, speed = self._handle.position, abs(self._handle.velocity)
        if abs(self._desired.position - position) < self._tolerance:
            self._end_goal(SUCCEEDED, GripperResult(position, self._effort, False, True))
        elif speed > self._stall_velocity or self._last_motion_ns is None:
            self._last_motion_ns = time_ns
        elif time_ns - self._last_motion_ns > self._stall_timeout_ns:
            self._end_goal(ABORTED, GripperResult(position, self._effort, True, False))

    def submit_goal(self, goal: GripperGoal) -> GoalHandle:
        """Start a goal, which replaces the previous one.

        Returns:
            The handle: active, or rejected with the reason in its result.
        """
        handle = GoalHandle(goal)
        refused = ""
        if not self._running:
            refused = "is not running; start it first"
        elif not (isfinite(goal.position) and isfinite(goal.max_effort)):
            refused = (f"position {goal.position} or effort {goal.max_effort} of the goal is not "
                       "finite; send finite numbers")
        if refused:
            text = f"controller '{self.context.name}': {refused}"
            handle.finish(REJECTED, GripperResult(text=text))
            return handle
        self._desired, self._last_motion_ns = goal, None
        self._preempt_goal("preempted by a new goal", handle)
        return handle

    def _preempt_goal(self, reason: str, next_goal: GoalHandle | None = None) -> None:
        self._end_goal(PREEMPTED, GripperResult(), next_goal)

    def _hold_position(self) -> None:
        self._desired = GripperGoal(self._handle.position, self._default_effort)


@register("position_controllers/GripperActionController", interface=POSITION)
class PositionGripperController(GripperActionController):
    """Command the goal's position; as in ros_controllers, the result repeats the goal's max_effort.
    """

    def _start_output(self) -> None:
        self._handle.position_command = self._handle.position

    def _command(self, period: float) -> float:
        self._handle.position_command = self._desired.position
        return self._desired.max_effort


@register("effort_controllers/GripperActionController", interface=EFFORT)
class EffortGripperController(GripperActionController):
    """Command effort = PID(position error), limited to the effort of the goal.

    The derivative of the error is minus the joint velocity. The gains are in `gains/<joint>`.
    """

    def _init_output(self, parameters: Mapping) -> None:
        self._pid = self.read_pid(parameters, f"gains/{self._handle.name}")

    def get_loop_gains(self) -> dict[str, tuple[float, float]]:
        return {self._handle.name: (self._pid.gains.p, self._pid.gains.d)}

    def _start_output(self) -> None:
        self._pid.reset()
        self._handle.effort_command = 0.0

    def _command(self, period: float) -> float:
        error = self._desired.position - self._handle.position
        most = abs(self._desired.max_effort)
        effort = self._pid.compute(error, period, -self._handle.velocity)
        self._handle.effort_command = effort = min(max(effort, -most), most)
        return effort
