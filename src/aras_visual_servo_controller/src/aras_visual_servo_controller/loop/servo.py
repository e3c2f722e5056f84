"""The servo loop without ROS: images in, joint commands out, at two rates.

    see(observation): features -> law -> task, once an image, checked wholly before it counts
    tick(t, joints):  task -> joint velocities -> commands, between the images as well

Phases: `waiting` (for joint states or images), `approaching` (the start pose, with the camera's
eyes shut), `servoing`, `converged` (the mean of the measured error over `hold` seconds within the
tolerances; the loop stays closed), `holding` (no safe answer: the arm comes smoothly to rest, and
goes on with the next good image), `stopped` (until `start`).

The commands are integrated from the last command, not from the measured positions: a joint held
back by friction is pushed until it moves; how far they may run ahead is bounded. Time is what
the stamps and `tick` say, simulated or not; nothing here reads a clock of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.names import unknown

from ..arm.joint_sample import JointSample
from ..arm.resolver import solve_ik
from ..errors import (
    ConfigurationError,
    MeasurementError,
    SchemeError,
    SchemeTimeoutError,
    ServoError,
)
from ..goals.goal import Goal
from ..judging.arrival import Arrival
from ..judging.diagnosis import Diagnosis
from ..judging.joint_check import foreign_text
from ..records.arrived import NOT_ARRIVED, Arrived
from ..records.outcomes import Outcome, outcome
from ..records.run_record import ImageRecord, JointRecord, Record, RunContext, RunEvent
from ..records.state import (
    APPROACHING,
    CONVERGED,
    HOLDING,
    SERVOING,
    STOPPED,
    WAITING,
    Command,
    ServoSettings,
    ServoState,
    Source,
)
from ..schemes.answer_checks import checked_goal
from ..schemes.base import Decision, JointController, Scheme
from ..schemes.compute import compute
from ..schemes.time_limit import call_user_code
from ..seeing.observation import Observation
from .approach import Approach
from .motion import CommandMotion
from .task_follower import Pursuit

if TYPE_CHECKING:
    from ..arm import Arm
    from ..arm.resolution import Resolution
    from ..arm.resolver import Resolver

# An image from so far in the future is left over from before the clock went back, s.
FUTURE = 1.0
SLOW = (
    "correct the scheme, or raise scheme_timeout if it needs that long; its traceback is logged; "
    "to see the rest run, use a shipped one"
)
CONTROLLED = ("position", "velocity", "acceleration")


class Servo:
    """The loop. Construct, `tick` with each joint state, `see` each image.

    Attributes:
        scheme, arm, resolver, settings: as given.
        goal: as this arm sees it.
        beyond: why the arm cannot be where the goal was taught, in words; empty where it can.
        phase, reason: of the loop now.
        source: of the images, for messages.
        motion, pursuit: where the commands stand, and what they go after.
        state: the latest ServoState, None before the first.
        keep: is given each record that the diagnosis reads; None: nobody keeps them.
    """

    def __init__(
        self,
        scheme: Scheme | JointController,
        arm: Arm,
        goal: Goal,
        resolver: Resolver,
        settings: ServoSettings | None = None,
        clock: Callable[[], float] | None = None,
        name: str = "",
    ) -> None:
        """`clock`: s of processor time, to tell a scheme that takes too long; `name`: of the
        scheme, for messages.

        Raises:
            ConfigurationError: goal, start or settings do not fit the arm or the scheme.
        """
        self.scheme, self.arm, self.resolver = scheme, arm, resolver
        self.settings = settings if settings is not None else ServoSettings()
        self.name = name or type(scheme).__name__
        self.source = Source()
        self.clock = clock
        self.goal = goal.for_arm(arm)
        checked_goal(self.name, scheme, self.goal, self.settings.scheme_timeout)
        self.settings.check_for(arm.names, resolver.limits)
        if isinstance(scheme, JointController) and scheme.output not in CONTROLLED:
            raise ConfigurationError(
                unknown(f"output of scheme {self.name}", scheme.output, CONTROLLED)
            )
        joints = self.goal.joint_values(arm.names)
        resolver.goal = self.goal.world_T_camera if joints is None else arm.view(joints)[0]
        self.motion = CommandMotion(arm.names, resolver.limits, self.settings)
        self.pursuit = Pursuit(self.name, scheme, resolver, self.motion, self.settings)
        self._to_start = None
        if self.settings.start is not None:
            self._to_start = self._approach_to(self.settings.start, "the start pose")
        self._arrival = Arrival(self.settings.hold)
        self.beyond = self.goal.beyond(arm)
        lengths = np.where(arm.prismatic, resolver.settings.slide, 1.0)
        narrowed = resolver.limits.narrowed(arm)
        self.diagnosis = Diagnosis(RunContext(
            self.settings, self.goal, scheme, arm.jacobian, self.beyond, tuple(arm.names), lengths,
            narrowed, getattr(resolver, "folds", ()),
            () if joints is None else resolver.limits.outside(joints),
        ))  # fmt: skip
        self.keep: Callable[[Record], None] | None = None
        self.reset()

    # -- what the loop is told -------------------------------------------------------------

    def reset(self) -> None:
        """Begin anew, as if just constructed: for a clock that went back."""
        self.phase, self.reason = WAITING, ""
        self.state: ServoState | None = None
        self.motion.reset()
        self._jumped, self._foreign = False, {}
        self._approach = self._to_start
        if self._approach is not None:
            self._approach.reset()
        self._note(RunEvent("started"))
        self._now: float | None = None
        self._joints: JointSample | None = None
        self._stamp: float | None = None
        self._period = 0.0
        self._held = ""
        self._began = 0.0
        self._fault = ""
        self._pause()
        self.resolver.reset()
        try:
            self._begin_scheme()
        except SchemeError as error:
            self._halt(HOLDING, str(error))  # the next image tries again

    def start(self) -> None:
        """Go on after `stop` or `hold`; the goal is taken up anew."""
        self._held = ""
        if self.phase in (STOPPED, HOLDING):
            if self._joints is not None:
                self.motion.take_up(self._joints.positions)
            self.phase, self.reason = WAITING, ""
        self._note(RunEvent("started"))
        self._pause()

    def stop(self, reason: str = "stopped") -> None:
        """Come smoothly to rest and stay there until `start`."""
        self._halt(STOPPED, reason)

    def hold(self, reason: str, found: Outcome | None = None) -> None:
        """Come smoothly to rest and hold still until `start`, whatever is seen.

        `found`: the outcome, where no client has asked for it; None: held.
        """
        self._held = reason or "held"
        self._halt(HOLDING, self._held)
        self._note(RunEvent("halted", outcome=found or outcome("held", self._held)))

    def time_out(self, duration: float) -> None:
        """The time for the run, s, is over: an outcome that is still open is judged."""
        self._note(RunEvent("timed_out", time=duration))

    def joints_jumped(self) -> None:
        """The joints may be elsewhere: command them from where they are, once the arm moves on."""
        self._jumped = True

    def set_foreign(self, nodes: Mapping[str, str]) -> None:
        """Name the other nodes that command joints now, by joint; empty: none does any more."""
        ended, self._foreign = bool(self._foreign) and not nodes, dict(nodes)
        if ended:
            self.foreign_commands_ended()

    @property
    def yields(self) -> bool:
        """Whether another node commands joints, and the loop waits for its end."""
        return bool(self._foreign)

    def foreign_commands_ended(self) -> None:
        """Command the joints again after another node did, from where they are.

        Where the images show no target since, the arm first returns to where it was to be.
        """
        if self.phase == HOLDING and not self._held and self.motion.command is not None:
            self._approach = self._approach_to(self.motion.command, "the last commanded pose")
        self._jumped = True

    def _approach_to(self, joints: Sequence[float], where: str) -> Approach:
        """The path to joints (n,)."""
        limits, settings = self.resolver.limits, replace(self.settings, start=tuple(joints))
        return Approach(self.arm.names, limits.velocity, settings, limits.acceleration, where)

    @property
    def waits_for_joints(self) -> bool:
        """Whether the command rests until joints have followed it: of itself never while the loop
        is stopped or held."""
        if self.phase == APPROACHING:
            return bool(self._approach.reason)
        if self.phase == HOLDING and not (self._held or self._jumped or self._joints is None):
            away = np.abs(self.motion.command - self._joints.positions)
            return self.motion.at_rest and bool((away > self.motion.lead).any())
        return self.phase in (SERVOING, CONVERGED) and bool(self.motion.late.any())

    @property
    def approaching(self) -> bool:
        """Whether the start pose has still to be reached: images are not looked at."""
        return self._approach is not None and not self._approach.done

    @property
    def outcome(self) -> Outcome:
        """What the loop knows of the run so far."""
        return self.diagnosis.outcome

    @property
    def command(self) -> np.ndarray | None:
        """(n,) positions that the commands stand at; None before the first tick."""
        return None if self.motion.command is None else self.motion.command.copy()

    # -- images ----------------------------------------------------------------------------

    def see(self, observation: Observation) -> ServoState:
        """Answer one image; whatever is wrong with it or with the scheme, the arm holds still.

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

    def _take_up_jumped(self, measured: JointSample) -> bool:
        """Command the joints from where they are, if they have jumped; whether they had."""
        jumped, self._jumped = self._jumped, False
        if jumped:
            self.motion.begin(measured.positions)
        return jumped

    def _hold_after(self, error: SchemeTimeoutError, what: str) -> None:
        """Hold until `start`: a scheme that hung would do so at every image."""
        reason = f"{error}, at the {what}"
        found = outcome("scheme_fault", reason)
        self.hold(reason, found.with_remedy(SLOW, *found.remedy.changes))

    def _begin_scheme(self) -> None:
        arguments = (self.arm,) if isinstance(self.scheme, JointController) else ()
        call_user_code(self.scheme.reset, *arguments, limit=self.settings.scheme_timeout,
                       scheme=self.name)  # fmt: skip

    def _pause(self) -> None:
        """Nothing is asked of the arm any more; the next image begins the scheme anew."""
        self.pursuit.drop()
        self._paused = True
        self._fresh, self._answered = False, None
        self._late = ""
        self.motion.wait_for_none()

    def _halt(self, phase: str, reason: str) -> None:
        self.phase, self.reason = phase, reason
        self._pause()
        self._arrival.clear()

    def _sent(self, t: float, measured: JointSample | None, reason: str) -> Command:
        if self._foreign:
            reason = self._with_foreign(reason)
        return self.motion.sent(t, measured, self.arm.effort, reason, self.phase)

    def _note(self, record: Record) -> Outcome:
        """Diagnose a record, and have it kept; the outcome as of now."""
        if self.keep is not None:
            self.keep(record)
        return self.diagnosis.add(record)

    def _with_foreign(self, reason: str) -> str:
        """A reason, with the other nodes that command joints."""
        return "; ".join(text for text in (reason, foreign_text(self._foreign)) if text)

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
        state = ServoState(
            float(observation.stamp), self.phase,
            reason=self._with_foreign(self.reason if reason is None else reason),
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
