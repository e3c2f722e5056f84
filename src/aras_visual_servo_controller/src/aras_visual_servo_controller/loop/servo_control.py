"""What a loop can be told between its images and ticks: start, stop, hold, who else commands."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.names import unknown

from ..arm.joint_sample import JointSample
from ..errors import (
    ConfigurationError,
    SchemeError,
    SchemeTimeoutError,
)
from ..goals.goal import Goal
from ..judging.arrival import Arrival
from ..judging.diagnosis import Diagnosis
from ..judging.joint_check import foreign_text
from ..records.outcomes import Outcome, outcome
from ..records.run_record import Record, RunContext, RunEvent
from ..records.state import (
    APPROACHING,
    CONVERGED,
    HOLDING,
    SERVOING,
    STOPPED,
    WAITING,
    ServoSettings,
    ServoState,
    Source,
)
from ..schemes.answer_checks import checked_goal
from ..schemes.base import JointController, Scheme
from ..schemes.time_limit import call_user_code
from .motion import CommandMotion
from .task_follower import Pursuit

if TYPE_CHECKING:
    from ..arm import Arm
    from ..arm.resolver import Resolver
    from .approach import Approach

SLOW = (
    "correct the scheme, or raise scheme_timeout if it needs that long; its traceback is logged; "
    "to see the rest run, use a shipped one"
)
CONTROLLED = ("position", "velocity", "acceleration")


class ServoControl:
    """Parts and state of a loop, and what starts and stops it; see Servo."""

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
        from .approach import Approach  # many runs servo from where they are

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

    def _note(self, record: Record) -> Outcome:
        """Diagnose a record, and have it kept; the outcome as of now."""
        if self.keep is not None:
            self.keep(record)
        return self.diagnosis.add(record)

    def _with_foreign(self, reason: str) -> str:
        """A reason, with the other nodes that command joints."""
        return "; ".join(text for text in (reason, foreign_text(self._foreign)) if text)
