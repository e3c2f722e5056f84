"""Services `start`, `stop` and `hold`, and the action `servo_to_target`."""

from __future__ import annotations

import contextlib
import threading
import time
from functools import partial
from typing import Protocol

import rospy
from actionlib import SimpleActionServer
from std_srvs.srv import Trigger, TriggerRequest, TriggerResponse

from ..msg import ServoToTargetAction, ServoToTargetFeedback, ServoToTargetGoal, ServoToTargetResult
from ..records.state import CONVERGED, STOPPED, ServoState
from ..runner.loop_runner import LoopRunner
from .ros_publisher import RosPublisher

FEEDBACK_PERIOD = 0.05  # wall time between two feedback messages, s
STATUS_PERIOD = 0.2  # wall time between two status messages, s, as in actionlib


class LoopOwner(Protocol):
    """Owner of the loop and its publisher, which are replaced when another robot is started."""

    runner: LoopRunner
    publisher: RosPublisher


class LoopServices:
    """Services and action of the control loop."""

    def __init__(self, namespace: str, owner: LoopOwner) -> None:
        """Advertise the services and the action in `namespace`."""
        self._owner = owner
        self._services = [
            rospy.Service(f"{namespace}/controller/{name}", Trigger, partial(self._call, name))
            for name in ("start", "stop", "hold")
        ]
        self._action = SimpleActionServer(
            f"{namespace}/servo_to_target", ServoToTargetAction, self._execute_goal,
            auto_start=False,
        )  # fmt: skip
        self._action.start()
        # actionlib's own status timer runs in simulated time: it would pause with the simulation,
        # and end when the clock is reset. The status is therefore published by a thread.
        self._action.action_server.status_timer.shutdown()
        threading.Thread(target=self._publish_status, name="status", daemon=True).start()

    def _publish_status(self) -> None:
        while not rospy.is_shutdown():
            # A ROSException is raised if the topic is closed at shutdown.
            with contextlib.suppress(rospy.ROSException):
                self._action.action_server.publish_status()
            time.sleep(STATUS_PERIOD)

    def _call(self, name: str, _: TriggerRequest) -> TriggerResponse:
        """Call the method `name` of the loop, which is start, stop or hold."""
        getattr(self._owner.runner, name)()
        return TriggerResponse(True, f"{name}: {self._owner.runner.servo.phase}")

    def _execute_goal(self, goal: ServoToTargetGoal) -> None:
        """Servo until the target is reached, the timeout expires, or a client cancels the goal."""
        start_time, initial_state = None, self._owner.publisher.latest_state
        self._owner.runner.start()
        while not rospy.is_shutdown():
            runner, state = self._owner.runner, self._owner.publisher.latest_state
            if self._action.is_preempt_requested():
                runner.stop("preempted")
                self._action.set_preempted(self._make_result("stopped", "preempted"))
                return
            phase, outcome = runner.servo.phase, runner.servo.outcome
            if state is not None and state is not initial_state:
                self._action.publish_feedback(_make_feedback(state))
                if state.phase == CONVERGED:
                    self._action.set_succeeded(self._make_result(state.outcome, state.reason))
                    return
            if phase == STOPPED:
                reason = outcome.reason or runner.servo.reason
                self._action.set_aborted(self._make_result(outcome.kind, reason, outcome.remedy))
                return
            start_time = rospy.get_time() if start_time is None else start_time
            if 0.0 < goal.timeout < rospy.get_time() - start_time:
                runner.stop("the timeout of the action goal has expired")
                kind = outcome.kind if outcome.kind != "running" else "timed_out"
                reason = outcome.reason or f"not converged within {goal.timeout:g} s"
                self._action.set_aborted(self._make_result(kind, reason, outcome.remedy))
                return
            time.sleep(FEEDBACK_PERIOD)

    def _make_result(self, outcome: str, reason: str, remedy: str = "") -> ServoToTargetResult:
        result = ServoToTargetResult(outcome=outcome, reason=reason, remedy=remedy)
        state = self._owner.publisher.latest_state
        if state is not None and state.scheme_output is not None:
            result.feature_names = list(state.scheme_output.names)
            result.error = [float(e) for e in state.scheme_output.error]
        return result


def _make_feedback(state: ServoState) -> ServoToTargetFeedback:
    feedback = ServoToTargetFeedback(phase=state.phase, outcome=state.outcome)
    if state.scheme_output is not None:
        feedback.feature_names = list(state.scheme_output.names)
        feedback.error = [float(e) for e in state.scheme_output.error]
    if state.ik_solution is not None:
        feedback.rank = state.ik_solution.rank
        feedback.margins = state.ik_solution.margins.tolist()
    return feedback
