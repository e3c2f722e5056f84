"""Control of the servo loop: construction, start, stop, hold, and commands of other nodes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from aras_visual_servo_base.names import describe_unknown

from ..diagnosis.arrival_check import ArrivalCheck
from ..diagnosis.diagnosis import Diagnosis
from ..diagnosis.joint_tracking_check import describe_foreign_nodes
from ..errors import (
    ConfigurationError,
    SchemeError,
    UnreachableError,
    UnresponsiveSchemeError,
)
from ..goals.goal import Goal
from ..kinematics.joint_sample import JointSample
from ..records.outcomes import Outcome, make_outcome
from ..records.run_record import Record, RunContext, RunEvent
from ..records.state import (
    APPROACHING,
    CONVERGED,
    HOLDING,
    SERVOING,
    STOPPED,
    WAITING,
    ImageSource,
    ServoSettings,
    ServoState,
)
from ..schemes.base import JointController, Scheme
from ..schemes.scheme_call import check_goal
from ..schemes.time_limit import call_user_code
from .command_integrator import CommandIntegrator
from .task_executor import TaskExecutor

if TYPE_CHECKING:
    from ..kinematics import Arm
    from ..kinematics.differential_ik import DifferentialIK
    from .start_approach import StartApproach

TIMEOUT_ADVICE = (
    "correct the scheme (its traceback is logged), raise scheme_timeout if it needs that long, or "
    "use a built-in scheme"
)
CONTROLLER_OUTPUTS = ("position", "velocity", "acceleration")


class ServoStateMachine:
    """State of a servo loop, and the methods that start and stop it; see Servo."""

    def __init__(
        self,
        scheme: Scheme | JointController,
        arm: Arm,
        goal: Goal,
        differential_ik: DifferentialIK,
        settings: ServoSettings | None = None,
        clock: Callable[[], float] | None = None,
        name: str = "",
    ) -> None:
        """Create the loop.

        Args:
            clock: function that returns the processor time, s, with which the computation time of
                the scheme is measured.
            name: name of the scheme, for messages.

        Raises:
            ConfigurationError: goal, start or settings do not fit the arm or the scheme.
        """
        self.scheme, self.arm, self.differential_ik = scheme, arm, differential_ik
        self.settings = settings if settings is not None else ServoSettings()
        self.name = name or type(scheme).__name__
        self.source = ImageSource()
        self.clock = clock
        self.goal = goal.for_arm(arm)
        check_goal(self.name, scheme, self.goal, self.settings.scheme_timeout)
        self.settings.check_for(arm.names, differential_ik.limits)
        if isinstance(scheme, JointController) and scheme.output not in CONTROLLER_OUTPUTS:
            raise ConfigurationError(
                describe_unknown(f"output of scheme {self.name}", scheme.output, CONTROLLER_OUTPUTS)
            )
        joints = self.goal.get_joints(arm.names)
        differential_ik.goal = (
            self.goal.world_T_camera if joints is None else arm.pose_and_jacobian(joints)[0]
        )
        self.integrator = CommandIntegrator(arm.names, differential_ik.limits, self.settings)
        self.executor = TaskExecutor(
            self.name, scheme, differential_ik, self.integrator, self.settings
        )
        self._to_start = None
        if self.settings.start is not None:
            self._to_start = self._make_approach(self.settings.start, "the start pose")
        self._arrival_check = ArrivalCheck(self.goal, scheme, self.settings.hold)
        self.unreachable_reason = ""
        try:
            self.goal.find_posture(arm)
        except UnreachableError as error:
            self.unreachable_reason = f"{self.goal.name}: {error}"
        lengths = np.where(arm.is_prismatic, differential_ik.settings.prismatic_unit, 1.0)
        narrowed = differential_ik.limits.find_narrowed(arm)
        self.diagnosis = Diagnosis(RunContext(
            self.settings, self.goal, scheme, arm.jacobian, self.unreachable_reason,
            tuple(arm.names), lengths,
            narrowed, getattr(differential_ik, "elbows", ()),
            () if joints is None else differential_ik.limits.find_violations(joints),
        ))  # fmt: skip
        self.on_record: Callable[[Record], None] | None = None
        self.reset()

    def reset(self) -> None:
        """Restore the initial state, for example after a reset of the clock."""
        self.phase, self.reason = WAITING, ""
        self.state: ServoState | None = None
        self.integrator.reset()
        self._have_joints_jumped, self._foreign_nodes = False, {}
        self._start_approach = self._to_start
        if self._start_approach is not None:
            self._start_approach.reset()
        self._add_record(RunEvent("started"))
        self._now: float | None = None
        self._joints: JointSample | None = None
        self._stamp: float | None = None
        self._period = 0.0
        self._hold_reason = ""
        self._start_stamp = 0.0
        self._fault = ""
        self._pause()
        self.differential_ik.reset()
        try:
            self._reset_scheme()
        except SchemeError as error:
            # If the reset of the scheme fails, it is tried again at the next image.
            self._halt(HOLDING, str(error))

    def start(self) -> None:
        """Continue after `stop` or `hold` and reset the scheme at the next image."""
        self._hold_reason = ""
        if self.phase in (STOPPED, HOLDING):
            if self._joints is not None:
                self.integrator.adopt_joints(self._joints.positions)
            self.phase, self.reason = WAITING, ""
        self._add_record(RunEvent("started"))
        self._pause()

    def stop(self, reason: str = "stopped") -> None:
        """Stop the arm smoothly until `start`."""
        self._halt(STOPPED, reason)

    def hold(self, reason: str, held_outcome: Outcome | None = None) -> None:
        """Stop the arm smoothly until `start`, regardless of images.

        Args:
            reason: why the arm is stopped, as text.
            held_outcome: outcome to report; None for the outcome 'held' after a client's request.
        """
        self._hold_reason = reason or "held"
        self._halt(HOLDING, self._hold_reason)
        self._add_record(
            RunEvent("halted", outcome=held_outcome or make_outcome("held", self._hold_reason))
        )

    def time_out(self, duration: float) -> None:
        """End the run after its duration (s); the diagnosis then gives its final outcome."""
        self._add_record(RunEvent("timed_out", time=duration))

    def mark_joint_jump(self) -> None:
        """Set the commands to the measured positions at the next update, as after a joint jump."""
        self._have_joints_jumped = True

    def set_foreign_nodes(self, nodes: Mapping[str, str]) -> None:
        """Set the names of the other nodes that command joints, by joint name; may be empty."""
        ended, self._foreign_nodes = bool(self._foreign_nodes) and not nodes, dict(nodes)
        if ended:
            self.resume_own_commands()

    @property
    def is_yielding(self) -> bool:
        """Return whether the loop waits because another node commands joints."""
        return bool(self._foreign_nodes)

    def resume_own_commands(self) -> None:
        """Resume commands at the present joint positions after another node has commanded them.

        If no target was visible during these commands, the arm first returns to its last commanded
        pose.
        """
        if self.phase == HOLDING and not self._hold_reason and self.integrator.command is not None:
            self._start_approach = self._make_approach(
                self.integrator.command, "the last commanded pose"
            )
        self._have_joints_jumped = True

    def _make_approach(self, joints: Sequence[float], destination: str) -> StartApproach:
        """Create the path to joints (n,)."""
        # Imported here to save time, because many runs do not start with a motion to a start pose.
        from .start_approach import StartApproach

        limits, settings = self.differential_ik.limits, replace(self.settings, start=tuple(joints))
        return StartApproach(
            self.arm.names, limits.velocity, settings, limits.acceleration, destination
        )

    @property
    def is_waiting_for_joints(self) -> bool:
        """Return whether the command waits for joints to follow.

        Return False while the loop is stopped or held on request.
        """
        if self.phase == APPROACHING:
            return bool(self._start_approach.reason)
        if self.phase == HOLDING and not (
            self._hold_reason or self._have_joints_jumped or self._joints is None
        ):
            away = np.abs(self.integrator.command - self._joints.positions)
            return self.integrator.is_at_rest and bool((away > self.integrator.lead).any())
        return self.phase in (SERVOING, CONVERGED) and any(self.integrator.is_late.tolist())

    @property
    def is_approaching(self) -> bool:
        """Return whether the arm is still moving to the start pose; then images are not processed.
        """
        return self._start_approach is not None and not self._start_approach.is_done

    @property
    def outcome(self) -> Outcome:
        """Return the present outcome of the run."""
        return self.diagnosis.outcome

    @property
    def command(self) -> np.ndarray | None:
        """Return the integrated positions (n,), or None before the first update."""
        return None if self.integrator.command is None else self.integrator.command.copy()

    def _adopt_jumped_joints(self, measured: JointSample) -> bool:
        """Set the command to the measured joints if they may have jumped.

        Return whether the command was set.
        """
        jumped, self._have_joints_jumped = self._have_joints_jumped, False
        if jumped:
            self.integrator.start_at(measured.positions)
        return jumped

    def _hold_after_timeout(self, error: UnresponsiveSchemeError, what: str) -> None:
        """Hold until `start` after a timeout, because the scheme would hang at every image."""
        reason = f"{error}, at the {what}"
        found = make_outcome("scheme_fault", reason)
        self.hold(reason, found.with_remedy(TIMEOUT_ADVICE, *found.remedy.changes))

    def _reset_scheme(self) -> None:
        arguments = (self.arm,) if isinstance(self.scheme, JointController) else ()
        call_user_code(self.scheme.reset, *arguments, limit=self.settings.scheme_timeout,
                       scheme=self.name)  # fmt: skip

    def _remove_task(self) -> None:
        """Remove the task, so that the arm stops."""
        self.executor.clear()
        self._lag_reason = ""
        self.integrator.clear_late()

    def _pause(self) -> None:
        """Remove the task, and reset the scheme at the next image."""
        self._remove_task()
        self._is_paused = True
        self._has_new_answer, self._answer_time = False, None

    def _halt(self, phase: str, reason: str) -> None:
        self.phase, self.reason = phase, reason
        self._pause()
        self._arrival_check.clear()

    def _add_record(self, record: Record) -> Outcome:
        """Pass a record to `on_record` and to the diagnosis; return the present outcome."""
        if self.on_record is not None:
            self.on_record(record)
        return self.diagnosis.add(record)

    def _add_foreign_nodes(self, reason: str) -> str:
        """Return the text `reason` with the names of the other nodes that command joints appended.
        """
        return "; ".join(
            text for text in (reason, describe_foreign_nodes(self._foreign_nodes)) if text
        )
