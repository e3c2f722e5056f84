"""Servo loop without ROS: from images to joint commands, at two rates.

    process_image(observation): called for each image: compute -> solve_ik
    update(t, joints):          called for each joint state: solve_ik -> commands

A call of `process_image` that fails has no effect.

Phases:

- `waiting`: the loop waits for joint states or images.
- `approaching`: the arm moves to the start pose, without images.
- `servoing`: the arm reduces the error.
- `converged`: the mean error over `hold` seconds is within the tolerances; servoing continues.
- `holding`: an image or joint state cannot be used, or the scheme failed, or a client called
  `hold`. The arm stops smoothly; it continues with the next valid image, or after `hold` with
  `start`.
- `stopped`: the arm is stopped until `start`.

Commands are integrated from the last command, not from the measured positions: if friction holds a
joint, the command increases until the joint moves. The distance between command and joint is
limited. The loop does not read a clock: it takes the time from the stamps and from `update`.
"""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from ..diagnosis.diagnosis import STEADY_TIME
from ..errors import (
    MeasurementError,
    SchemeError,
    ServoError,
    UnresponsiveSchemeError,
)
from ..kinematics.differential_ik import solve_ik
from ..kinematics.joint_sample import JointSample
from ..observation.observation import Observation
from ..records.outcomes import NOT_ARRIVED, ArrivalStatus, Outcome, make_outcome
from ..records.run_record import ImageRecord, RunEvent
from ..records.state import (
    APPROACHING,
    CONVERGED,
    HOLDING,
    SERVOING,
    STOPPED,
    WAITING,
    JointCommand,
    ServoState,
)
from ..schemes.base import SchemeOutput
from ..schemes.scheme_call import compute
from .servo_state_machine import ServoStateMachine

if TYPE_CHECKING:
    from ..kinematics.ik_solution import IKSolution

# Largest time, s, by which an image's stamp may be in the future. An image with a later stamp was
# sent before a reset of the clock.
MAX_STAMP_LEAD = 1.0
# A camera at its goal counts as arrived until no image or no joint state has come for this time, s.
# A busy machine delays messages by some tenths of a second, in which the camera does not move.
GOAL_PATIENCE = STEADY_TIME


class Servo(ServoStateMachine):
    """Servo loop; call `update` for each joint state and `process_image` for each image.

    The loop moves the camera of one arm as one scheme requires. `process_image` computes the joint
    velocities for an image; `update` integrates them into commands (n,) of positions, velocities or
    efforts. The ROS node and the runner of experiments both use this class. If an image cannot be
    used or the scheme fails, the arm stops and `reason` says why.

    Attributes:
        scheme, arm, differential_ik, settings: arguments of the constructor.
        goal: goal for this arm, see `Goal.for_arm`.
        unreachable_reason: why the arm cannot reach the goal's pose, as text; empty if it can.
        phase: present phase of the loop.
        reason: what limits or stops the loop, as text.
        source: source of the images, for messages.
        integrator: integrator of the commands.
        executor: object that computes the joint velocities between images.
        state: latest ServoState; None before the first image.
        on_record: function that is called with each record of the diagnosis, or None.
    """

    def process_image(self, observation: Observation) -> ServoState:
        """Compute the joint velocities for one image.

        If the image cannot be used or the scheme fails, the arm stops. An image that is not newer
        than the last one has no effect.
        """
        stamp = float(observation.stamp)
        if not (isfinite(stamp) and (self._stamp is None or stamp > self._stamp)
                and (self._now is None or stamp <= self._now + MAX_STAMP_LEAD)):
            fault = self._explain_stamp_fault(stamp)
            return self._record(observation, reason=f"the image stamped {stamp:.3f} s is ignored: "
                                                    f"{fault}")
        if self._stamp is not None:
            self._period = stamp - self._stamp
        self._stamp = stamp
        if self.phase == STOPPED or self._hold_reason:
            return self._record(observation)
        if self._start_approach is not None and self.is_approaching:
            if self._start_approach is self._to_start or not observation.valid:
                return self._record(observation)
            # The arm was returning to its last commanded pose, but the target is visible again: end
            # the return.
            self._start_approach, self._have_joints_jumped = None, True
        joints = observation.joints if observation.joints is not None else self._joints
        if joints is None:
            self._halt(WAITING, "no joint states yet")
            return self._record(observation)
        start_time = None if self.clock is None else self.clock()
        solution = None
        try:  # the state of the loop changes only after all calls in this block succeed
            self.arm.check(joints.positions, joints.velocities)
            if self._is_paused and self.integrator.is_at_rest:
                # The arm is at rest: reset integrals and the initial transient of the law.
                self._start_stamp = stamp
                self._reset_scheme()
                self._arrival_check.clear()
            output = compute(
                self.scheme, observation, self.goal, stamp - self._start_stamp, self.name,
                self.settings.scheme_timeout,
            )  # fmt: skip
            if output.task is not None:
                solution = solve_ik(
                    output.task, joints.positions, self.differential_ik,
                    self.settings.resolve_period,
                    self.integrator.velocity,
                )  # fmt: skip
        except MeasurementError as error:
            self._halt(HOLDING, str(error))
            return self._record(observation)
        except UnresponsiveSchemeError as error:
            self._hold_after_timeout(error, f"image of {stamp:.2f} s")
            return self._record(observation, fault=error.trace)
        except SchemeError as error:
            new = str(error) != self._fault
            self._fault = str(error)
            self._halt(HOLDING, str(error))
            return self._record(observation, fault=(error.trace or str(error)) if new else "",
                                is_faulty=True)  # fmt: skip
        except (ServoError, ValueError, ArithmeticError) as error:
            self._halt(HOLDING, str(error))
            return self._record(observation, scheme_output=None)
        seconds = 0.0 if start_time is None else self.clock() - start_time
        return self._commit(observation, joints, output, solution, seconds)

    def _explain_stamp_fault(self, stamp: float) -> str:
        """Describe why an image of this stamp (s) cannot be used."""
        if not isfinite(stamp):
            return "its stamp is not finite"
        if self._stamp is not None and stamp <= self._stamp:
            return "it is not newer than the last image"
        return "its stamp is ahead of the joint states"

    def _commit(
        self, observation: Observation, joints: JointSample, scheme_output: SchemeOutput,
        solution: IKSolution | None, seconds: float,
    ) -> ServoState:
        """Execute the task of an image, and check whether the camera has arrived."""
        stamp = observation.stamp
        self._is_paused, self._fault = False, ""
        self._has_new_answer = True
        task, dropped = scheme_output.task, ""
        if not (task is None or task.is_exact or task.measurable_task is task):
            task, dropped = task.measurable_task, task.dropped_reason
        self.executor.set_task(task, solution, stamp, self._now)
        arrived = self._arrival_check.add(scheme_output, observation, solution)
        self.phase = CONVERGED if arrived.is_reached else SERVOING
        reasons = [
            *(() if solution is None else solution.reasons), dropped, *scheme_output.notes,
            self._lag_reason, arrived.pending_reason,
        ]  # fmt: skip
        if seconds > self._period > 0.0:
            reasons.append(
                f"scheme {self.name} took {seconds:.3f} s, longer than the image period of "
                f"{self._period:.3f} s"
            )
        self.reason = "; ".join(filter(None, dict.fromkeys(reasons)))
        return self._record(
            observation, joints, scheme_output, solution, seconds, arrival_status=arrived
        )

    def update(
        self,
        t: float,
        joints: JointSample | None = None,
        missing_reason: str = "",
        missing_outcome: Outcome | None = None,
    ) -> JointCommand:
        """Advance the loop to the time t (s) and return the joint command.

        If t is before the previous time, the clock was reset, and the loop is reset, too.

        Args:
            t: present time, s.
            joints: new joint sample, or None.
            missing_reason: why the joints could not be measured, as text. If it is given, the arm
                is stopped.
            missing_outcome: outcome to report; None for the outcome 'no_joint_states'.
        """
        t = float(t)
        if not isfinite(t):
            return self._make_command(
                0.0 if self._now is None else self._now, None, "time is not finite"
            )
        if self._now is not None and t < self._now:
            self.reset()
        dt = 0.0 if self._now is None else min(t - self._now, self.settings.longest_step)
        self._now = t
        if joints is not None:
            try:
                self.arm.check(joints.positions, joints.velocities)
                self._joints = joints
            except MeasurementError as error:
                missing_reason = str(error)
                missing_outcome = make_outcome("unusable_joint_states", missing_reason)
        if missing_reason:
            self._stop_without_joints(t, missing_reason, missing_outcome)
            self.integrator.brake(dt)
            return self._make_command(t, self._joints, missing_reason)
        if self._joints is None:
            self.phase = WAITING if self.phase != STOPPED else STOPPED
            return self._make_command(t, None, "no joint states yet")
        measured = self._joints
        if self.integrator.command is None:
            self.integrator.start_at(measured.positions)
        if (
            self._start_approach is not None and self.is_approaching
            and self.phase != STOPPED and not self._hold_reason
        ):  # fmt: skip
            return self._update_approach(t, dt, measured)
        if self._has_new_answer:
            self._has_new_answer, self._answer_time = False, t
        elif self.phase in (SERVOING, CONVERGED):
            self._check_watchdog(t)
        return self._make_command(t, measured, self._execute_task(t, dt, measured) or self.reason)

    def _stop_without_joints(self, t: float, reason: str, outcome: Outcome | None) -> None:
        """Remove the task, because the joints cannot be measured."""
        if self.phase == STOPPED or self._hold_reason:
            return
        joints_stamp = None if self._joints is None else self._joints.stamp
        if outcome is None and joints_stamp is not None and self._is_gap_at_goal(t, joints_stamp):
            self._remove_task()
            return
        is_new = (self.phase, self.reason) != (HOLDING, reason)
        self._halt(HOLDING, reason)
        if is_new:
            self._add_record(RunEvent("joints_unmeasured", reason, outcome))

    def _execute_task(self, t: float, dt: float, measured: JointSample) -> str:
        """Integrate the velocities of the present task, and return what limits them, as text."""
        if self.executor.pending_tasks:
            self.executor.activate_pending(t)
        if self._foreign_nodes:
            self.integrator.yield_to(
                [name in self._foreign_nodes for name in self.integrator.names], dt
            )
            return ""
        if self.executor.task is not None and dt <= 0.0:
            # At the start of the loop or after an image, t may equal the previous time; wait for a
            # newer joint state.
            return ""
        try:
            result = self.executor.compute_velocities(t, dt, measured, self._start_stamp)
        except UnresponsiveSchemeError as error:
            self._hold_after_timeout(error, f"joints of {t:.2f} s")
        except SchemeError as error:
            self._fault = str(error)
            self._halt(HOLDING, str(error))
            self._add_record(RunEvent("scheme_failed", str(error)))
        except (ServoError, ValueError, ArithmeticError) as error:
            self._halt(HOLDING, str(error))
        else:
            if result is None:
                self.integrator.brake(dt)
                return ""
            velocities, reason = result
            if self._have_joints_jumped:
                self._adopt_jumped_joints(measured)
            self._lag_reason = self.integrator.integrate(velocities, measured.positions, dt)
            return "; ".join(text for text in (reason, self._lag_reason) if text)
        self.integrator.brake(dt)
        return self.reason

    def _check_watchdog(self, t: float) -> None:
        """Stop the arm if no new task has arrived in time."""
        answered, patience = self.answer_timing
        if answered is None or t - answered <= patience:
            return
        if self._is_gap_at_goal(t, answered):
            self._remove_task()
            return
        self._halt(WAITING, self.source.describe_silence(self._stamp))
        self._add_record(RunEvent("starved", self.reason, time=t, period=self._period))

    def _is_gap_at_goal(self, t: float, last: float) -> bool:
        """Return whether a missing input is ignored, because the camera is at its goal.

        At the goal, images or joint states may be missing for up to GOAL_PATIENCE.

        Args:
            t: present time, s.
            last: time of the last image or joint state, s.
        """
        return self.phase == CONVERGED and t - last <= GOAL_PATIENCE

    def _update_approach(self, t: float, dt: float, measured: JointSample) -> JointCommand:
        self.phase = APPROACHING
        if self._adopt_jumped_joints(measured):
            self._start_approach.reset()
        command = self._start_approach.compute_command(t, dt, measured.positions)
        if dt > 0.0:
            self.integrator.velocity = (command - self.integrator.command) / dt
        self.integrator.command = command
        self.reason = self._start_approach.reason
        if self._start_approach.is_done:
            self.phase, self.reason = WAITING, ""
            self.integrator.velocity = np.zeros_like(command)
        return self._make_command(t, measured, self.reason)

    @property
    def is_only_executing(self) -> bool:
        """Return whether the next call of `update` only has to continue the present task.

        This is not the case just after an image, or after the joints have jumped.
        """
        return self.phase in (SERVOING, CONVERGED) and not (
            self._has_new_answer or self._have_joints_jumped
        )

    @property
    def answer_timing(self) -> tuple[float, float]:
        """Return the time of the last processed image, and how long its task may be executed, s."""
        settings = self.settings
        return self._answer_time, max(settings.watchdog, settings.watchdog_images * self._period)

    def apply_updates(self, joints: JointSample, lag_reason: str) -> None:
        """Store the results of updates that compiled code has computed instead of `update`.

        Args:
            joints: joint sample of the last update.
            lag_reason: which joints were late in the last update, as text.
        """
        self._now, self._joints, self._lag_reason = joints.stamp, joints, lag_reason

    def _make_command(self, t: float, measured: JointSample | None, reason: str) -> JointCommand:
        if self._foreign_nodes:
            reason = self._add_foreign_nodes(reason)
        return self.integrator.make_command(t, measured, self.arm.effort, reason, self.phase)

    def _record(
        self,
        observation: Observation,
        joints: JointSample | None = None,
        scheme_output: SchemeOutput | None = None,
        solution: IKSolution | None = None,
        seconds: float = 0.0,
        fault: str = "",
        reason: str | None = None,
        is_faulty: bool = False,
        arrival_status: ArrivalStatus = NOT_ARRIVED,
    ) -> ServoState:
        """Create the state after this image, pass a record to the diagnosis, and add its outcome.
        """
        text, command = self.reason if reason is None else reason, self.integrator.command
        state = ServoState(
            float(observation.stamp), self.phase,
            reason=self._add_foreign_nodes(text) if self._foreign_nodes else text,
            scheme_output=scheme_output, ik_solution=solution,
            joints=joints or observation.joints or self._joints,
            command=None if command is None else command.copy(),
            computation_time=seconds, fault=fault, has_processed_image=reason is None,
            scheme=self.name, arrival_status=arrival_status,
        )  # fmt: skip
        if reason is None:
            joints = None
            if self._joints is not None:
                joints = (
                    self.integrator.is_late, self.integrator.velocity, self._joints.velocities
                )  # fmt: skip
            age = max(self.settings.delay, 0.0 if self._now is None else self._now - state.stamp)
            found = self._add_record(ImageRecord(
                state, observation.without_pixels(), age, is_faulty, joints, self._foreign_nodes
            ))
            state = state.with_outcome(found)
            if scheme_output is not None and self.phase == SERVOING and (
                self.settings.duration <= observation.stamp - self._start_stamp
            ):
                self.time_out(self.settings.duration)
                self.stop("the duration of the run is over")
            self.state = state
        return state
