"""The servo loop without ROS: images in, joint commands out, at two rates.

    see(observation): compute -> solve_ik, once an image; nothing changes unless all of it succeeds
    tick(t, joints):  solve_ik -> commands, between the images as well

Phases: `waiting` (for joint states or images), `is_approaching` (the start pose, without images),
`servoing`, `converged` (the mean of the measured error over `hold` seconds is within the
tolerances; the loop stays closed), `holding` (no safe answer: the arm comes smoothly to rest, and
continues with the next good image), `stopped` (until `start`).

The commands are integrated from the last command, not from the measured positions: a joint held
back by friction is pushed until it moves; how far they may run ahead is bounded. Time is what
the stamps and `update` say, simulated or not; the loop reads no clock of its own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..errors import (
    MeasurementError,
    SchemeError,
    SchemeTimeoutError,
    ServoError,
)
from ..kinematics.differential_ik import solve_ik
from ..kinematics.joint_sample import JointSample
from ..observation.observation import Observation
from ..records.outcomes import NOT_ARRIVED, ArrivalStatus
from ..records.run_record import ImageRecord, JointRecord, RunEvent
from ..records.state import (
    APPROACHING,
    CONVERGED,
    HOLDING,
    SERVOING,
    STOPPED,
    WAITING,
    Command,
    ServoState,
)
from ..schemes.base import SchemeOutput
from ..schemes.compute import compute
from .servo_control import ServoControl

if TYPE_CHECKING:
    from ..kinematics.ik_solution import IKSolution

# An image from so far in the future is left over from before the clock went back, s.
MAX_STAMP_LEAD = 1.0


class Servo(ServoControl):
    """The loop. Construct, `update` with each joint state, `process_image` each image.

    Closes v = L^+ e_dot around one scheme and one arm: `process_image` computes the joint
    velocities of an image, `update` integrates them into commands (n,) of positions, velocities
    or efforts. Node and
    runner both use this class. If an image cannot be used or the scheme fails, the arm holds still
    and `reason` says why.

    Attributes:
        scheme, arm, resolver, settings: as given.
        goal: as this arm sees it.
        beyond: why the arm cannot be where the goal was taught, as text; empty where it can.
        phase, reason: of the loop now.
        source: of the images, for messages.
        motion, pursuit: integrates the commands; computes the velocities between images.
        state: the latest ServoState, None before the first.
        keep: function that gets each record that the diagnosis reads; None: they are not stored.
    """

    # -- images ----------------------------------------------------------------------------

    def process_image(self, observation: Observation) -> ServoState:
        """Answer one image. If it cannot be used or the scheme fails, the arm holds still.

        An image that is not newer than the last one changes nothing.
        """
        stamp = float(observation.stamp)
        late = self._stamp is not None and stamp <= self._stamp
        early = self._now is not None and stamp > self._now + MAX_STAMP_LEAD
        if late or early or not np.isfinite(stamp):
            return self._record(observation, reason=f"image of {stamp:.3f} s ignored: it is late")
        if self._stamp is not None:
            self._period = stamp - self._stamp
        self._stamp = stamp
        if self.phase == STOPPED or self._hold_reason:
            return self._record(observation)
        if self.is_approaching:
            if self._start_approach is self._to_start or not observation.valid:
                return self._record(observation)
            # the target is visible on the way back
            self._start_approach, self._have_joints_jumped = None, True
        joints = observation.joints if observation.joints is not None else self._joints
        if joints is None:
            self._halt(WAITING, "no joint states yet")
            return self._record(observation)
        began = None if self.clock is None else self.clock()
        solution = None
        try:  # everything that can go wrong, before anything counts
            self.arm.check(joints.positions, joints.velocities)
            if self._is_paused and self.integrator.is_at_rest:
                # The arm stands: integrals and the start's profile begin anew.
                self._start_stamp = stamp
                self._reset_scheme()
                self._arrival_check.clear()
            decision = compute(
                self.scheme, observation, self.goal, stamp - self._start_stamp, self.name,
                self.settings.scheme_timeout,
            )  # fmt: skip
            if decision.task is not None:
                solution = solve_ik(
                    decision.task, joints.positions, self.differential_ik,
                    self.settings.resolve_period,
                    self.integrator.velocity,
                )  # fmt: skip
        except MeasurementError as error:
            self._halt(HOLDING, str(error))
            return self._record(observation)
        except SchemeTimeoutError as error:
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
        seconds = 0.0 if began is None else self.clock() - began
        return self._commit(observation, joints, decision, solution, seconds)

    def _commit(
        self,
        observation: Observation,
        joints: JointSample,
        scheme_output: SchemeOutput,
        solution: IKSolution | None,
        seconds: float,
    ) -> ServoState:
        stamp = observation.stamp
        self._is_paused, self._fault = False, ""
        self._has_new_answer = True
        task, dropped = scheme_output.task, ""
        if task is not None and task.measurable_task is not task:
            task, dropped = task.measurable_task, task.dropped_reason
        self.executor.set_task(task, solution, stamp, self._now)
        arrived = self._arrival_check.add(
            scheme_output, observation, self.goal, self.scheme, solution
        )
        self.phase = CONVERGED if arrived.is_reached else SERVOING
        reasons = [] if solution is None else list(solution.reasons)
        reasons += [
            t
            for t in (dropped, *scheme_output.notes, self._lag_reason, arrived.pending_reason)
            if t
        ]
        if seconds > self._period > 0.0:
            reasons.append(
                f"scheme {self.name} took {seconds:.3f} s, longer than the image period of "
                f"{self._period:.3f} s"
            )
        self.reason = "; ".join(dict.fromkeys(reasons))
        return self._record(
            observation, joints, scheme_output, solution, seconds, arrival_status=arrived
        )

    # -- ticks -----------------------------------------------------------------------------

    def update(
        self, t: float, joints: JointSample | None = None, missing_reason: str = ""
    ) -> Command:
        """Move on to the time t (s, of the clock); measured joints where there are new ones, or
        why they could not be measured, which stops the arm.

        A t before the last one is a clock that went back: the loop begins anew.
        """
        t = float(t)
        if not np.isfinite(t):
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
        if missing_reason:
            if self.phase != STOPPED and not self._hold_reason:
                self._halt(HOLDING, missing_reason)
                self._add_record(RunEvent("joints_unmeasured", missing_reason))
            self.integrator.brake(dt)
            return self._make_command(t, self._joints, missing_reason)
        if self._joints is None:
            self.phase = WAITING if self.phase != STOPPED else STOPPED
            return self._make_command(t, None, "no joint states yet")
        measured = self._joints
        if self.integrator.command is None:
            self.integrator.start_at(measured.positions)
        if self.is_approaching and self.phase != STOPPED and not self._hold_reason:
            return self._update_approach(t, dt, measured)
        self._check_watchdog(t)
        return self._make_command(t, measured, self._execute_task(t, dt, measured) or self.reason)

    def _execute_task(self, t: float, dt: float, measured: JointSample) -> str:
        """Integrate what was asked last; what held it back, in words."""
        self.executor.activate_pending(t)
        if self._foreign_nodes:
            self.integrator.yield_to(
                [name in self._foreign_nodes for name in self.integrator.names], dt
            )
            return ""
        if self.executor.task is not None and dt <= 0.0:
            return ""  # an image's own instant: the joints will be newer when time goes on
        try:
            asked = self.executor.compute_velocities(t, dt, measured, self._start_stamp)
        except SchemeTimeoutError as error:
            self._hold_after_timeout(error, f"joints of {t:.2f} s")
        except SchemeError as error:
            self._fault = str(error)
            self._halt(HOLDING, str(error))
            self._add_record(RunEvent("scheme_failed", str(error)))
        except (ServoError, ValueError, ArithmeticError) as error:
            self._halt(HOLDING, str(error))
        else:
            if asked is None:
                self.integrator.brake(dt)
                return ""
            velocities, reason = asked
            if self._have_joints_jumped:
                self._adopt_jumped_joints(measured)
            self._lag_reason = self.integrator.integrate(velocities, measured.positions, dt)
            return "; ".join(text for text in (reason, self._lag_reason) if text)
        self.integrator.brake(dt)
        return self.reason

    def _check_watchdog(self, t: float) -> None:
        """Stop the arm when no fresh answer comes."""
        if self._has_new_answer:
            self._has_new_answer, self._answer_time = False, t
        if self.phase not in (SERVOING, CONVERGED):
            return
        answered, patience = self.answer_timing
        if answered is not None and t - answered > patience:
            self._add_record(RunEvent("starved", time=t, period=self._period))
            self._halt(WAITING, self.source.describe_silence(t - answered))

    def _update_approach(self, t: float, dt: float, measured: JointSample) -> Command:
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
        """Whether the coming ticks do nothing but go after the task."""
        return self.phase in (SERVOING, CONVERGED) and not (
            self._has_new_answer or self._have_joints_jumped
        )

    @property
    def answer_timing(self) -> tuple[float, float]:
        """When the last image was answered, and for how long that is enough, s."""
        settings = self.settings
        return self._answer_time, max(settings.watchdog, settings.watchdog_images * self._period)

    def apply_updates(self, joints: JointSample, lag_reason: str) -> None:
        """Ticks were made up to these joints; what was late in the last one, in words."""
        self._now, self._joints, self._lag_reason = joints.stamp, joints, lag_reason

    # -- shared ----------------------------------------------------------------------------

    def _make_command(self, t: float, measured: JointSample | None, reason: str) -> Command:
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
        """The state of this image, with what the diagnosis makes of it."""
        own = self.reason if reason is None else reason
        state = ServoState(
            float(observation.stamp), self.phase,
            reason=self._add_foreign_nodes(own) if self._foreign_nodes else own,
            scheme_output=scheme_output, ik_solution=solution,
            joints=joints or observation.joints or self._joints, command=self.command,
            computation_time=seconds, fault=fault, has_processed_image=reason is None,
            scheme=self.name, arrival_status=arrival_status,
        )  # fmt: skip
        if reason is None:
            joints = None
            if self._joints is not None:
                joints = JointRecord(
                    self.integrator.is_late, self.integrator.velocity, self._joints.velocities
                )
            age = max(self.settings.delay, 0.0 if self._now is None else self._now - state.stamp)
            found = self._add_record(ImageRecord(
                state, observation.without_pixels(), age, is_faulty, joints, self._foreign_nodes
            ))
            state = state.with_outcome(found)
            if scheme_output is not None and self.phase == SERVOING and (
                self.settings.duration <= observation.stamp - self._start_stamp
            ):
                self.time_out(self.settings.duration)
                self.stop("the time for it is over")
            self.state = state
        return state
