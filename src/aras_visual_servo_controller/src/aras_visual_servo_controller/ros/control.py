"""Start, stop and hold as services; the action servo_to_target; gains by dynamic_reconfigure."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from typing import Protocol

import rospy
from actionlib import SimpleActionServer
from std_srvs.srv import Trigger, TriggerRequest, TriggerResponse

from ..driving.driver import Driver
from ..msg import ServoToTargetAction, ServoToTargetFeedback, ServoToTargetGoal, ServoToTargetResult
from ..records.state import CONVERGED, STOPPED, ServoState
from .face import RosFace

FEEDBACK_PERIOD = 0.05  # s of wall time
STATUS_PERIOD = 0.2  # s of wall time, actionlib's own


class Owner(Protocol):
    """Who has the driver and its face; both may be made anew for another robot."""

    driver: Driver
    face: RosFace


class Control:
    """What others may ask of the loop."""

    def __init__(self, space: str, owner: Owner) -> None:
        """`space`: namespace of the services and the action."""
        self._owner = owner
        self._services = [
            rospy.Service(f"{space}/controller/{name}", Trigger, self._serve(name))
            for name in ("start", "stop", "hold")
        ]
        self._action = SimpleActionServer(
            f"{space}/servo_to_target", ServoToTargetAction, self._execute, auto_start=False
        )
        self._action.start()
        # actionlib's timer goes by simulated time: it stands while that does, and dies of a reset.
        self._action.action_server.status_timer.shutdown()
        threading.Thread(target=self._tell_status, name="status", daemon=True).start()

    def _tell_status(self) -> None:
        while not rospy.is_shutdown():
            with contextlib.suppress(rospy.ROSException):  # the topic is closed: the node ends
                self._action.action_server.publish_status()
            time.sleep(STATUS_PERIOD)

    def _serve(self, name: str) -> Callable[[TriggerRequest], TriggerResponse]:
        def serve(_: TriggerRequest) -> TriggerResponse:
            getattr(self._owner.driver, name)()
            return TriggerResponse(True, f"{name}: {self._owner.driver.servo.phase}")

        return serve

    def _execute(self, goal: ServoToTargetGoal) -> None:
        """Servo until the target is reached, the time is over, or somebody wants otherwise."""
        began, before = None, self._owner.face.latest
        self._owner.driver.start()
        while not rospy.is_shutdown():
            driver, state = self._owner.driver, self._owner.face.latest
            if self._action.is_preempt_requested():
                driver.stop("preempted")
                self._action.set_preempted(self._result("stopped", "preempted"))
                return
            phase, outcome = driver.servo.phase, driver.servo.outcome
            if state is not None and state is not before:
                self._action.publish_feedback(_feedback(state))
                if state.phase == CONVERGED:
                    self._action.set_succeeded(self._result(state.outcome, state.reason))
                    return
            if phase == STOPPED:
                reason = outcome.reason or driver.servo.reason
                self._action.set_aborted(self._result(outcome.kind, reason, outcome.remedy))
                return
            began = rospy.get_time() if began is None else began
            if 0.0 < goal.timeout < rospy.get_time() - began:
                driver.stop("the time for it is over")
                kind = outcome.kind if outcome.kind != "running" else "timed_out"
                reason = outcome.reason or f"not converged within {goal.timeout:g} s"
                self._action.set_aborted(self._result(kind, reason, outcome.remedy))
                return
            time.sleep(FEEDBACK_PERIOD)

    def _result(self, outcome: str, reason: str, remedy: str = "") -> ServoToTargetResult:
        result = ServoToTargetResult(outcome=outcome, reason=reason, remedy=remedy)
        state = self._owner.face.latest
        if state is not None and state.decision is not None:
            result.feature_names = list(state.decision.names)
            result.error = [float(e) for e in state.decision.error]
        return result


def _feedback(state: ServoState) -> ServoToTargetFeedback:
    feedback = ServoToTargetFeedback(phase=state.phase, outcome=state.outcome)
    if state.decision is not None:
        feedback.feature_names = list(state.decision.names)
        feedback.error = [float(e) for e in state.decision.error]
    if state.resolution is not None:
        feedback.rank = state.resolution.rank
        feedback.margins = state.resolution.margins.tolist()
    return feedback
