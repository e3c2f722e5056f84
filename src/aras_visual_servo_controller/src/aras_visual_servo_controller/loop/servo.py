"""The servo loop without ROS: images in, joint commands out, at two rates.

    see(observation): compute -> solve_ik, once an image; nothing changes unless all of it succeeds
    tick(t, joints):  solve_ik -> commands, between the images as well

Phases: `waiting` (for joint states or images), `approaching` (the start pose, without images),
`servoing`, `converged` (the mean of the measured error over `hold` seconds is within the
tolerances; the loop stays closed), `holding` (no safe answer: the arm comes smoothly to rest, and
continues with the next good image), `stopped` (until `start`).

The commands are integrated from the last command, not from the measured positions: a joint held
back by friction is pushed until it moves; how far they may run ahead is bounded. Time is what
the stamps and `tick` say, simulated or not; the loop reads no clock of its own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..arm.joint_sample import JointSample
from ..arm.resolver import solve_ik
from ..errors import (
    MeasurementError,
    SchemeError,
    SchemeTimeoutError,
    ServoError,
)
from ..records.outcomes import NOT_ARRIVED, Arrived
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
from ..schemes.base import Decision
from ..schemes.compute import compute
from ..seeing.observation import Observation
from .servo_control import ServoControl

if TYPE_CHECKING:
    from ..arm.resolution import Resolution

# An image from so far in the future is left over from before the clock went back, s.
FUTURE = 1.0


class Servo(ServoControl):
    """The loop. Construct, `tick` with each joint state, `see` each image.

    Closes v = L^+ e_dot around one scheme and one arm: `see` computes the joint velocities of an
    image, `tick` integrates them into commands (n,) of positions, velocities or efforts. Node and
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

    def see(self, observation: Observation) -> ServoState:
        """Answer one image. If it cannot be used or the scheme fails, the arm holds still.

        An image that is not newer than the last one changes nothing.
        """
        stamp = float(observation.stamp)
        late = self._stamp is not None and stamp <= self._stamp
        early = self._now is not None and stamp > self._now + FUTURE
        if late or early or not np.isfinite(stamp):
            return self._record(observation, reason=f"image of {stamp:.3f} s ignored: it is late")
        if self._stamp is not None:
            self._period = stamp - self._stamp
        self._stamp = stamp
        if self.phase == STOPPED or self._held:
            return self._record(observation)
        if self.approaching:
            if self._approach is self._to_start or not observation.valid:
                return self._record(observation)
            self._approach, self._jumped = None, True  # the target is visible on the way back
        joints = observation.joints if observation.joints is not None else self._joints
        if joints is None:
            self._halt(WAITING, "no joint states yet")
            return self._record(observation)
        began = None if self.clock is None else self.clock()
        solution = None
        try:  # everything that can go wrong, before anything counts
            self.arm.check(joints.positions, joints.velocities)
            if self._paused and self.motion.at_rest:
                # The arm stands: integrals and the start's profile begin anew.
                self._began = stamp
                self._begin_scheme()
                self._arrival.clear()
            decision = compute(
                self.scheme, observation, self.goal, stamp - self._began, self.name,
                self.settings.scheme_timeout,
            )  # fmt: skip
            if decision.task is not None:
                solution = solve_ik(
                    decision.task, joints.positions, self.resolver, self.settings.resolve_period,
                    self.motion.velocity,
                )  # fmt: skip
        except MeasurementError as error:
            self._halt(HOLDING, str(error))
            return self._record(observation)
        except SchemeTimeoutError as error:
            self._hold_after(error, f"image of {stamp:.2f} s")
            return self._record(observation, fault=error.trace)
        except SchemeError as error:
            new = str(error) != self._fault
            self._fault = str(error)
            self._halt(HOLDING, str(error))
            return self._record(observation, fault=(error.trace or str(error)) if new else "",
                                faulty=True)  # fmt: skip
        except (ServoError, ValueError, ArithmeticError) as error:
            self._halt(HOLDING, str(error))
            return self._record(observation, decision=None)
        seconds = 0.0 if began is None else self.clock() - began
        return self._commit(observation, joints, decision, solution, seconds)

    def _commit(
        self,
        observation: Observation,
        joints: JointSample,
        decision: Decision,
        resolution: Resolution | None,
        seconds: float,
    ) -> ServoState:
        stamp = observation.stamp
        self._paused, self._fault = False, ""
        self._fresh = True
        task, dropped = decision.task, ""
        if task is not None and task.measurable is not task:
            task, dropped = task.measurable, task.dropped
        self.pursuit.ask(task, resolution, stamp, self._now)
        arrived = self._arrival.add(decision, observation, self.goal, self.scheme, resolution)
        self.phase = CONVERGED if arrived.reached else SERVOING
        reasons = [] if resolution is None else list(resolution.reasons)
        reasons += [t for t in (dropped, *decision.notes, self._late, arrived.short) if t]
        if seconds > self._period > 0.0:
            reasons.append(
                f"scheme {self.name} took {seconds:.3f} s, longer than the image period of "
                f"{self._period:.3f} s"
            )
        self.reason = "; ".join(dict.fromkeys(reasons))
        return self._record(
            observation, joints, decision, resolution, seconds, arrived=arrived
        )

    # -- ticks -----------------------------------------------------------------------------

    def tick(
        self, t: float, joints: JointSample | None = None, unmeasured: str = ""
    ) -> Command:
        """Move on to the time t (s, of the clock); measured joints where there are new ones, or
        why they could not be measured, which stops the arm.

        A t before the last one is a clock that went back: the loop begins anew.
        """
        t = float(t)
        if not np.isfinite(t):
            return self._sent(0.0 if self._now is None else self._now, None, "time is not finite")
        if self._now is not None and t < self._now:
            self.reset()
        dt = 0.0 if self._now is None else min(t - self._now, self.settings.longest_step)
        self._now = t
        if joints is not None:
            try:
                self.arm.check(joints.positions, joints.velocities)
                self._joints = joints
            except MeasurementError as error:
                unmeasured = str(error)
        if unmeasured:
            if self.phase != STOPPED and not self._held:
                self._halt(HOLDING, unmeasured)
                self._note(RunEvent("joints_unmeasured", unmeasured))
            self.motion.brake(dt)
            return self._sent(t, self._joints, unmeasured)
        if self._joints is None:
            self.phase = WAITING if self.phase != STOPPED else STOPPED
            return self._sent(t, None, "no joint states yet")
        measured = self._joints
        if self.motion.command is None:
            self.motion.begin(measured.positions)
        if self.approaching and self.phase != STOPPED and not self._held:
            return self._approached(t, dt, measured)
        self._watch(t)
        return self._sent(t, measured, self._move(t, dt, measured) or self.reason)

    def _move(self, t: float, dt: float, measured: JointSample) -> str:
        """Integrate what was asked last; what held it back, in words."""
        self.pursuit.take_up(t)
        if self._foreign:
            self.motion.yield_to([name in self._foreign for name in self.motion.names], dt)
            return ""
        if self.pursuit.task is not None and dt <= 0.0:
            return ""  # an image's own instant: the joints will be newer when time goes on
        try:
            asked = self.pursuit.velocities(t, dt, measured, self._began)
        except SchemeTimeoutError as error:
            self._hold_after(error, f"joints of {t:.2f} s")
        except SchemeError as error:
            self._fault = str(error)
            self._halt(HOLDING, str(error))
            self._note(RunEvent("scheme_failed", str(error)))
        except (ServoError, ValueError, ArithmeticError) as error:
            self._halt(HOLDING, str(error))
        else:
            if asked is None:
                self.motion.brake(dt)
                return ""
            velocities, reason = asked
            if self._jumped:
                self._take_up_jumped(measured)
            self._late = self.motion.advance(velocities, measured.positions, dt)
            return "; ".join(text for text in (reason, self._late) if text)
        self.motion.brake(dt)
        return self.reason

    def _watch(self, t: float) -> None:
        """Stop the arm when no fresh answer comes."""
        if self._fresh:
            self._fresh, self._answered = False, t
        if self.phase not in (SERVOING, CONVERGED):
            return
        answered, patience = self.answered
        if answered is not None and t - answered > patience:
            self._note(RunEvent("starved", time=t, period=self._period))
            self._halt(WAITING, self.source.missing(t - answered))

    def _approached(self, t: float, dt: float, measured: JointSample) -> Command:
        self.phase = APPROACHING
        if self._take_up_jumped(measured):
            self._approach.reset()
        command = self._approach.command(t, dt, measured.positions)
        if dt > 0.0:
            self.motion.velocity = (command - self.motion.command) / dt
        self.motion.command = command
        self.reason = self._approach.reason
        if self._approach.done:
            self.phase, self.reason = WAITING, ""
            self.motion.velocity = np.zeros_like(command)
        return self._sent(t, measured, self.reason)

    @property
    def goes_on(self) -> bool:
        """Whether the coming ticks do nothing but go after the task."""
        return self.phase in (SERVOING, CONVERGED) and not (self._fresh or self._jumped)

    @property
    def answered(self) -> tuple[float, float]:
        """When the last image was answered, and for how long that is enough, s."""
        settings = self.settings
        return self._answered, max(settings.watchdog, settings.watchdog_images * self._period)

    def ticked(self, joints: JointSample, late: str) -> None:
        """Ticks were made up to these joints; what was late in the last one, in words."""
        self._now, self._joints, self._late = joints.stamp, joints, late

    # -- shared ----------------------------------------------------------------------------

    def _sent(self, t: float, measured: JointSample | None, reason: str) -> Command:
        if self._foreign:
            reason = self._with_foreign(reason)
        return self.motion.sent(t, measured, self.arm.effort, reason, self.phase)

    def _record(
        self,
        observation: Observation,
        joints: JointSample | None = None,
        decision: Decision | None = None,
        resolution: Resolution | None = None,
        seconds: float = 0.0,
        fault: str = "",
        reason: str | None = None,
        faulty: bool = False,
        arrived: Arrived = NOT_ARRIVED,
    ) -> ServoState:
        """The state of this image, with what the diagnosis makes of it."""
        own = self.reason if reason is None else reason
        state = ServoState(
            float(observation.stamp), self.phase,
            reason=self._with_foreign(own) if self._foreign else own,
            decision=decision, resolution=resolution,
            joints=joints or observation.joints or self._joints, command=self.command,
            computing=seconds, fault=fault, answers_image=reason is None,
            scheme=self.name, arrived=arrived,
        )  # fmt: skip
        if reason is None:
            joints = None
            if self._joints is not None:
                joints = JointRecord(
                    self.motion.late, self.motion.velocity, self._joints.velocities
                )
            age = max(self.settings.delay, 0.0 if self._now is None else self._now - state.stamp)
            found = self._note(ImageRecord(
                state, observation.without_pixels(), age, faulty, joints, self._foreign
            ))
            state = state.with_outcome(found)
            if decision is not None and self.phase == SERVOING and (
                self.settings.duration <= observation.stamp - self._began
            ):
                self.time_out(self.settings.duration)
                self.stop("the time for it is over")
            self.state = state
        return state
