"""What the loop is set to, what it answers, and in which words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from aras_visual_servo_base.settings import check_bounds, parameter

from ..errors import ConfigurationError
from ..kinematics.ik_solution import IKSolution, rank
from ..kinematics.joint_sample import JointSample
from ..kinematics.limits import Limits, check_within_limits
from ..kinematics.task import Task
from ..schemes.base import SchemeOutput
from .outcomes import NOT_ARRIVED, ArrivalStatus, Outcome

WAITING, APPROACHING, SERVOING = "waiting", "approaching", "servoing"
CONVERGED, HOLDING, STOPPED = "converged", "holding", "stopped"
OUTPUTS = ("position", "velocity", "effort")


PerJoint = float | tuple[float, ...] | Mapping[str, float]


def joint_parameter(default: float | None, unit: str = "", **bounds: float) -> Any:
    """A setting that may be said for each joint."""
    wanted = "a number, a list of numbers in the arm's order, or {joint: number}"
    return parameter(default, unit, expected=wanted, **bounds)


@dataclass(frozen=True)
class ServoSettings:
    """Settings of the servo loop; what may be one number or (n,) is for all joints, or for each.

    The parameters of the node and the experiments have units, defaults and bounds of these. With
    `lead` and `lag` all joints wait for one that friction holds back, so that its command stays
    near it.

    start: (n,) joints to go to before servoing; None: servo from anywhere.
    duration: s, servoing time after which the run has timed out; inf: never.
    hold: s, time over which the mean error has to be within the tolerances.
    approach_speed: part of max_velocity on the path to the start.
    arrived: m, rad, distance from the start that counts as there.
    push: 1/s, rate at which the command moves on for a joint that stays short of the start.
    settle: s, time at rest at the start before servoing.
    longest_step: s, longest gap between ticks that is integrated in full.
    lead: m, rad, distance by which a command may be ahead of its joint.
    lag: s, further lead, times the speed of the joint.
    delay: s, time from exposure to its answer, in simulated time. In lockstep, where commands go
        out with images alone, an answer acts from the first image on that its delay is over.
    watchdog: s, time without a fresh answer (or three image periods) before the arm is stopped.
    watchdog_images: image periods that count likewise.
    stop_time: s, time in which a stop comes to rest.
    scheme_timeout: s, wall time that a call of the scheme's code may take before the loop holds as
        after a fault of the scheme.
    resolve_period: s, time for which joint velocities are kept before they are computed again.
    output: what is commanded: position, velocity or effort.
    stiffness: N/m, N m/rad, joint stiffness of the effort output.
    damping: N s/m, N m s/rad, joint damping of the effort output; that near singularities is
        `damping` of IKSettings.
    """

    start: Sequence[float] | None = None
    hold: float = parameter(2.0, "s", above=0.0)
    approach_speed: float = parameter(0.3, above=0.0, most=1.0)
    arrived: float | Sequence[float] = parameter(0.005, "m, rad", least=0.0)
    push: float = parameter(3.0, "1/s", least=0.0)
    settle: float = parameter(0.3, "s", least=0.0)
    longest_step: float = parameter(0.1, "s", above=0.0)
    lead: PerJoint = joint_parameter(0.05, "m, rad", least=0.0)
    lag: float = parameter(0.15, "s", least=0.0)
    delay: float = parameter(0.0, "s", least=0.0)
    watchdog: float = parameter(0.2, "s", above=0.0)
    watchdog_images: float = parameter(3.0, least=0.0)
    scheme_timeout: float = parameter(30.0, "s", above=0.0)
    stop_time: float = parameter(0.15, "s", above=0.0, most=10.0)
    # Those of an arm that moves slowly, away from its limits, serve until the next image or 0.05 s.
    resolve_period: float = parameter(0.01, "s", above=0.0)
    output: str = parameter("position", choices=OUTPUTS)
    stiffness: PerJoint = joint_parameter(0.0, "N/m, N m/rad", least=0.0)
    damping: PerJoint = joint_parameter(0.0, "N s/m, N m s/rad", least=0.0)
    duration: float = parameter(float("inf"), "s", above=0.0)

    def __post_init__(self) -> None:
        check_bounds(self, ConfigurationError)

    def check_for(self, names: Sequence[str], limits: Limits) -> None:
        """Refuse what does not fit an arm with these joints.

        Raises:
            ConfigurationError: naming the setting, its value and what would be right.
        """
        for key in ("arrived", "lead", "stiffness", "damping", "start"):
            value = getattr(self, key)
            shapes = ((len(names),),) if key == "start" else ((), (len(names),))
            if value is not None and np.shape(value) not in shapes:
                raise ConfigurationError(
                    f"{key} is {value}: " + ("a" if key == "start" else "one number, or a")
                    + f" number for each of {', '.join(names)} is needed"
                )
        if self.output == "effort" and not np.any(self.stiffness):
            raise ConfigurationError(
                "output 'effort' pushes joints by stiffness times the way they are off, and "
                "stiffness is 0: give it, N/m or N m/rad, and damping"
            )
        if self.start is not None:
            check_within_limits(np.asarray(self.start, float), limits, "start")


@dataclass(frozen=True)
class Source:
    """Where images come from, for messages; who sends them: the node to be asked after."""

    content: str = "image"
    topic: str = ""
    sender: str = ""

    def describe_silence(self, seconds: float | None = None) -> str:
        """That nothing comes from there, `seconds` long, in words."""
        text = f"no {self.content}" + (f" on {self.topic}" if self.topic else "")
        text += "" if seconds is None else f" for {seconds:.2f} s"
        return text + (f" (is {self.sender} running?)" if self.sender else "")

    def describe_stamp_lead(self, seconds: float) -> str:
        """That its stamps are `seconds` ahead of the clock, in words."""
        where = f" on {self.topic}" if self.topic else ""
        same = "(is use_sim_time the same for both?)"
        return f"{self.content}{where} are stamped {seconds:.2f} s ahead of the clock {same}"


@dataclass(frozen=True, eq=False)
class Command:
    """What is to be sent at one tick; None: nothing.

    Attributes:
        stamp: of the tick, s.
        names: n joints.
        values: (n,) to be sent. kind: what they are, one of OUTPUTS.
        reason: what holds the motion back; empty when nothing does.
        phase: of the loop after this tick.
    """

    stamp: float
    names: tuple[str, ...]
    values: np.ndarray | None = None
    kind: str = "position"
    reason: str = ""
    phase: str = ""

    @property
    def positions(self) -> np.ndarray | None:
        """(n,) where positions are sent, else None."""
        return self.values if self.kind == "position" else None


@dataclass(frozen=True, eq=False)
class ServoState:
    """What the loop saw, decided and wants, for one image (or one event without an image).

    Attributes:
        stamp: of the exposure, s.
        phase: WAITING, APPROACHING, SERVOING, CONVERGED, HOLDING or STOPPED.
        outcome, reason, remedy: what the loop knows of the run so far; see diagnosis. The reason is
            that of the outcome, with what holds the loop back now.
        scheme: its name; empty where the loop has not told it.
        decision: of the scheme; None where there is none.
        resolution: of the resolver for it: joint velocities, singular values of L J, and so on.
            A state that was read from messages has SchemeOutput.task None: see
            Resolution.read_back.
        joints: measured, at the exposure.
        command: (n,) positions that the integration stands at; None before the first.
        computing: s that the scheme took, where a clock was handed in.
        fault: traceback of the scheme's fault, in the state where it came up first.
        answers_image: False for an image that came late, and for a report between images.
        arrived: whether the camera is at its goal by this image, and how much is left open.
    """

    stamp: float
    phase: str
    outcome: str = "running"
    reason: str = ""
    remedy: str = ""
    scheme_output: SchemeOutput | None = None
    ik_solution: IKSolution | None = None
    joints: JointSample | None = None
    command: np.ndarray | None = None
    computation_time: float = 0.0
    fault: str = ""
    has_processed_image: bool = False
    scheme: str = ""
    arrival_status: ArrivalStatus = NOT_ARRIVED

    def with_outcome(self, run_outcome: Outcome) -> ServoState:
        """The state with an outcome: its reason, followed by the loop's own, and its remedy."""
        reason = self.reason
        if run_outcome.reason and not run_outcome.is_open:
            own = reason and reason not in run_outcome.reason
            reason = f"{run_outcome.reason}; now: {reason}" if own else run_outcome.reason
        return replace(self, outcome=run_outcome.kind, reason=reason, remedy=run_outcome.remedy)

    @property
    def _task(self) -> Task | None:
        return None if self.scheme_output is None else self.scheme_output.task

    @property
    def desired_twist(self) -> np.ndarray:
        """(6,) asked of the camera, optical frame; zero where none was."""
        if self._task is None:
            return np.zeros(6) if self.ik_solution is None else self.ik_solution.desired_twist
        return self._task.twist

    @property
    def achieved_twist(self) -> np.ndarray:
        """(6,) of it that the joint velocities give."""
        return np.zeros(6) if self.ik_solution is None else self.ik_solution.achieved_twist

    @property
    def rank(self) -> int:
        """How many directions of the camera the features tell, of those that are modelled."""
        if self._task is None:
            return rank(self.singular_values_L)
        return self._task.rank

    @property
    def dropped_reason(self) -> str:
        """Which part of the commanded twist is not servoed, and why, as text; see Task."""
        return "" if self._task is None else self._task.dropped_reason

    @property
    def singular_values_L(self) -> np.ndarray:
        """Of L in its modelled directions, largest first."""
        if self._task is None:
            return np.zeros(0) if self.ik_solution is None else self.ik_solution.singular_values_L
        return self._task.singular_values

    @property
    def names(self) -> tuple[str, ...]:
        """Of the features; none without a decision."""
        return () if self.scheme_output is None else tuple(self.scheme_output.names)

    @property
    def error(self) -> np.ndarray | None:
        """(k,) as measured; None without a decision."""
        return None if self.scheme_output is None else self.scheme_output.error
