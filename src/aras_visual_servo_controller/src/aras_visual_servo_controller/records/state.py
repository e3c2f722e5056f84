"""Settings, states and commands of the servo loop, and texts that describe them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from aras_visual_servo_base.settings import check_bounds, parameter

from ..errors import ConfigurationError
from ..kinematics.command_limits import CommandLimits, check_within_limits
from ..kinematics.ik_solution import IKSolution, rank
from ..kinematics.joint_sample import JointSample
from ..kinematics.task import Task
from ..schemes.base import SchemeOutput
from .outcomes import NOT_ARRIVED, ArrivalStatus, Outcome

WAITING, APPROACHING, SERVOING = "waiting", "approaching", "servoing"
CONVERGED, HOLDING, STOPPED = "converged", "holding", "stopped"
PHASES = (WAITING, APPROACHING, SERVOING, CONVERGED, HOLDING, STOPPED)
OUTPUTS = ("position", "velocity", "effort")


class RunStartDetector:
    """Detector of the starts of runs in the phases of consecutive states.

    A run starts when the arm starts to move to its start pose, and again when servoing starts, so
    that the plots of a run do not contain this motion. WAITING does not end a run, because the loop
    also reports it between two images that are late.
    """

    def __init__(self) -> None:
        self._phase = ""

    def is_start(self, phase: str) -> bool:
        """Return whether a run starts with the next state, which has this phase."""
        if phase == WAITING:
            return False
        before, self._phase = self._phase, phase
        if phase == APPROACHING:
            return before != APPROACHING
        return phase in (SERVOING, CONVERGED) and before in ("", APPROACHING, STOPPED)


PerJoint = float | tuple[float, ...] | Mapping[str, float]


def joint_parameter(default: float | None, unit: str = "", **bounds: float) -> Any:
    """Declare a setting that can be given for each joint."""
    text = "a number, a list of numbers in the arm's order, or {joint: number}"
    return parameter(default, unit, expected=text, **bounds)


@dataclass(frozen=True)
class ServoSettings:
    """Settings of the servo loop.

    A setting of the joints is one number for all joints, or one number for each joint. The
    parameters of the node and of experiments have the same units, defaults and bounds. The
    commanded position may be ahead of a joint by `lead` + `lag` times the joint's speed. If it is
    farther ahead, all joints wait for that joint.

    start: joints (n,) to go to before servoing; None to servo from the present joints.
    duration: s, servoing time after which the run times out; inf for no limit.
    hold: s, time over which the mean error has to be within the tolerances.
    approach_speed: speed on the path to the start, as a fraction of max_velocity.
    arrived: m, rad, largest distance from the start at which the start is reached.
    push: 1/s, gain of the integral correction for a joint that stops short of the start.
    settle: s, time at rest at the start before servoing.
    longest_step: s, longest time step; a longer time between two updates is integrated as this
        step.
    lead: m, rad, distance by which a commanded position may be ahead of its joint at rest.
    lag: s, additional lead per unit of joint speed.
    delay: s, simulated time from the exposure of an image until its task starts. In lockstep,
        commands are sent only when images arrive, so the task starts with the first image after the
        delay.
    watchdog: s, time without a new task after which the arm is stopped.
    watchdog_images: number of image periods without a new task after which the arm is stopped, if
        these are longer than `watchdog`.
    stop_time: s, time in which a stop brings the arm to rest.
    scheme_timeout: s, wall time that a call of the scheme's code may take. After that, the loop
        holds the arm as after a fault of the scheme.
    resolve_period: s, time after which the joint velocities of a task are computed again.
    output: commanded quantity: position, velocity or effort.
    stiffness: N/m, N m/rad, joint stiffness of the effort output.
    damping: N s/m, N m s/rad, joint damping of the effort output; for singularities see `damping`
        of IKSettings.
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
    # While the arm moves slowly and is away from its limits, the same joint velocities are used
    # longer than `resolve_period`: until the next image, but at most for 0.05 s.
    resolve_period: float = parameter(0.01, "s", above=0.0)
    output: str = parameter("position", choices=OUTPUTS)
    stiffness: PerJoint = joint_parameter(0.0, "N/m, N m/rad", least=0.0)
    damping: PerJoint = joint_parameter(0.0, "N s/m, N m s/rad", least=0.0)
    duration: float = parameter(float("inf"), "s", above=0.0)

    def __post_init__(self) -> None:
        check_bounds(self, ConfigurationError)

    def check_for(self, names: Sequence[str], limits: CommandLimits) -> None:
        """Check that the settings fit an arm with the joints `names` and the given limits.

        Raises:
            ConfigurationError: a setting is wrong; the message names it, its value and the expected
                value.
        """
        for key in ("arrived", "lead", "stiffness", "damping", "start"):
            value = getattr(self, key)
            shapes = ((len(names),),) if key == "start" else ((), (len(names),))
            if value is not None and np.shape(value) not in shapes:
                raise ConfigurationError(
                    f"{key} is {value}, must be " + ("a" if key == "start" else "one number, or a")
                    + f" number for each of {', '.join(names)}"
                )
        if self.output == "effort" and not np.any(self.stiffness):
            raise ConfigurationError(
                "output 'effort' needs a joint stiffness, but stiffness is 0: set stiffness (N/m "
                "or N m/rad) and damping"
            )
        if self.start is not None:
            check_within_limits(np.asarray(self.start, float), limits, "start")


@dataclass(frozen=True)
class ImageSource:
    """Source of the images, for messages: content, topic and sending node."""

    content: str = "image"
    topic: str = ""
    sender: str = ""

    def describe_silence(self, since: float | None = None) -> str:
        """Return a text that says that no images arrive from the source.

        Args:
            since: stamp of the last image, s; None if it is not reported.
        """
        text = f"no {self.content}" + (f" on {self.topic}" if self.topic else "")
        text += "" if since is None else f" since {since:.2f} s"
        return text + (f" (is {self.sender} running?)" if self.sender else "")

    def describe_stamp_lead(self, seconds: float) -> str:
        """Return a message that the stamps of the source are `seconds` ahead of the clock.

        If `seconds` is negative, the message says that they are behind the clock.
        """
        where = f" on {self.topic}" if self.topic else ""
        lead = f"{abs(seconds):.2f} s {'ahead of' if seconds > 0.0 else 'behind'} the clock"
        return (
            f"{self.content}{where} are stamped {lead} (check that both use the same use_sim_time)"
        )


@dataclass(eq=False)
class JointCommand:
    """Joint command of one update.

    Attributes:
        stamp: time of the update, s.
        names: names of the n joints.
        values: (n,) values to send; None to send nothing.
        kind: quantity of the values, one of OUTPUTS.
        reason: what limits or stops the motion; empty if nothing does.
        phase: phase of the loop after this update.
    """

    stamp: float
    names: tuple[str, ...]
    values: np.ndarray | None = None
    kind: str = "position"
    reason: str = ""
    phase: str = ""

    @property
    def positions(self) -> np.ndarray | None:
        """Return the positions (n,) of a position command; None for other commands."""
        return self.values if self.kind == "position" else None


@dataclass(eq=False)
class ServoState:
    """State of the loop at one image, or at an event without an image.

    Attributes:
        stamp: stamp of the exposure, s.
        phase: WAITING, APPROACHING, SERVOING, CONVERGED, HOLDING or STOPPED.
        outcome, reason, remedy: result of the diagnosis so far. `reason` says why the run has this
            outcome and what limits the loop at present.
        scheme: name of the scheme; empty if it is unknown.
        scheme_output: measurement and task of the scheme; None if there is no measurement.
        ik_solution: joint velocities for the task, with the singular values of L J.
        joints: measured joints at the exposure.
        command: (n,) integrated positions of the command; None before the first command.
        computation_time: computation time of the scheme, s, if a clock was given.
        fault: traceback of an error in the scheme; only in the first state with this error.
        has_processed_image: whether the image was processed; False for an image that is older than
            the last one, and for a state between images.
        arrival_status: whether the camera is at its goal, and the uncertainty of its pose there.
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
        """Return a copy of the state with the kind, reason and remedy of an outcome.

        If the outcome has a reason, its text precedes the present reason: 'OUTCOME; now: PRESENT'.
        """
        reason = self.reason
        if run_outcome.reason and not run_outcome.is_open:
            is_other = reason and reason not in run_outcome.reason
            reason = f"{run_outcome.reason}; now: {reason}" if is_other else run_outcome.reason
        if (run_outcome.kind, reason, run_outcome.remedy) == (
            self.outcome, self.reason, self.remedy
        ):  # fmt: skip
            return self
        return replace(self, outcome=run_outcome.kind, reason=reason, remedy=run_outcome.remedy)

    @property
    def _task(self) -> Task | None:
        return None if self.scheme_output is None else self.scheme_output.task

    @property
    def desired_twist(self) -> np.ndarray:
        """Return the desired twist (6,) of the camera in its optical frame; zeros without a task.
        """
        if self._task is None:
            return np.zeros(6) if self.ik_solution is None else self.ik_solution.desired_twist
        return self._task.twist

    @property
    def achieved_twist(self) -> np.ndarray:
        """Return the camera twist (6,) that the joint velocities achieve."""
        return np.zeros(6) if self.ik_solution is None else self.ik_solution.achieved_twist

    @property
    def rank(self) -> int:
        """Number of camera directions that the features measure accurately enough; see `Task.rank`.
        """
        if self._task is None:
            return rank(self.singular_values_L)
        return self._task.rank

    @property
    def dropped_reason(self) -> str:
        """Camera motion that is desired but too uncertain to be commanded, as text with the reason.
        """
        return "" if self._task is None else self._task.dropped_reason

    @property
    def singular_values_L(self) -> np.ndarray:
        """Singular values of L for the directions that the task controls, in descending order."""
        if self._task is None:
            return np.zeros(0) if self.ik_solution is None else self.ik_solution.singular_values_L
        return self._task.singular_values

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the features; empty without a scheme output."""
        return () if self.scheme_output is None else tuple(self.scheme_output.names)

    @property
    def error(self) -> np.ndarray | None:
        """Return the measured error (k,); None without a scheme output."""
        return None if self.scheme_output is None else self.scheme_output.error
