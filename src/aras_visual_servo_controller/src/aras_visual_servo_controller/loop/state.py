"""What the loop is set to, what it answers, and in which words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..arm.resolution import Resolution, rank
from ..arm.task import Task
from ..errors import ConfigurationError
from ..judging.arrival import NOT_ARRIVED, Arrived
from ..schemes.base import Decision
from ..seeing.joint_sample import JointSample

if TYPE_CHECKING:
    from ..arm.limits import Limits

WAITING, APPROACHING, SERVOING = "waiting", "approaching", "servoing"
CONVERGED, HOLDING, STOPPED = "converged", "holding", "stopped"
OUTPUTS = ("position", "velocity", "effort")
PHASES = (WAITING, APPROACHING, SERVOING, CONVERGED, HOLDING, STOPPED)


@dataclass(frozen=True)
class ServoSettings:
    """Numbers of the loop; where a value may be one number or (n,), one counts for all joints.

    Attributes:
        start: (n,) joints to go to before the eyes are opened; None: servo from anywhere.
        hold: s over which the mean of the measured error is judged.
        approach_speed: part of the joints' greatest speed used to reach the start.
        arrived: distance from the start that counts as there, rad or m.
        push: 1/s with which the command runs after a joint that stays short of the start.
        settle: s to stand still at the start before servoing.
        longest_step: s; a longer gap between ticks is integrated as this long.
        lead, lag: a command may be ahead of the measured joint by lead + lag |its speed|, rad or m
            and s; then all wait: friction that holds a joint does not let its command walk away.
        delay: s from an exposure to when its answer counts (simulated time, computing included);
            0: at once.
        watchdog, watchdog_images: without a fresh answer for this long, s, or for so many image
            periods, whichever is longer, the arm is stopped smoothly.
        stop_time: s in which a smooth stop comes to rest, if the acceleration limits allow it.
        resolve_period: s for which joint velocities are kept before they are worked out anew;
            those of an arm that moves slowly, away from its limits, serve until the next image
            or for 0.05 s.
        output: what is sent: 'position', 'velocity' or 'effort'.
        stiffness, damping: of the effort output, per rad or m of what the command is ahead.
        duration: s of servoing after which the run has timed out; inf: never.
    """

    start: Sequence[float] | None = None
    hold: float = 2.0
    approach_speed: float = 0.3
    arrived: float | Sequence[float] = 0.005
    push: float = 3.0
    settle: float = 0.3
    longest_step: float = 0.1
    lead: float | Sequence[float] = 0.05
    lag: float = 0.15
    delay: float = 0.0
    watchdog: float = 0.2
    watchdog_images: float = 3.0
    stop_time: float = 0.15
    resolve_period: float = 0.01
    output: str = "position"
    stiffness: float | Sequence[float] = 0.0
    damping: float | Sequence[float] = 0.0
    duration: float = float("inf")


@dataclass(frozen=True)
class Source:
    """Where images come from, for messages; who sends them: the node to be asked after."""

    what: str = "image"
    topic: str = ""
    who: str = ""

    def missing(self, seconds: float | None = None) -> str:
        """That nothing comes from there, `seconds` long, in words."""
        text = f"no {self.what}" + (f" on {self.topic}" if self.topic else "")
        text += "" if seconds is None else f" for {seconds:.2f} s"
        return text + (f" (is {self.who} running?)" if self.who else "")


@dataclass(frozen=True, eq=False)
class Command:
    """What is to be sent at one tick; None: nothing.

    Attributes:
        stamp: of the tick, s.
        names: n joints.
        positions, velocities, efforts: (n,), of the chosen output alone.
        reason: what holds the motion back; empty when nothing does.
        phase: of the loop after this tick.
    """

    stamp: float
    names: tuple[str, ...]
    positions: np.ndarray | None = None
    velocities: np.ndarray | None = None
    efforts: np.ndarray | None = None
    reason: str = ""
    phase: str = ""


@dataclass(frozen=True, eq=False)
class ServoState:
    """What the loop saw, decided and wants, for one image (or one event without an image).

    Attributes:
        stamp: of the exposure, s.
        phase: one of PHASES.
        outcome, reason, mend: what the loop knows of the run so far; see diagnosis.
        scheme: its name; empty where the loop has not told it.
        decision: of the scheme; None where there is none.
        resolution: of the resolver for it: joint velocities, singular values of L J, and so on.
            A state that was read from messages has Decision.task None: see Resolution.read_back.
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
    mend: str = ""
    decision: Decision | None = None
    resolution: Resolution | None = None
    joints: JointSample | None = None
    command: np.ndarray | None = None
    computing: float = 0.0
    fault: str = ""
    answers_image: bool = False
    scheme: str = ""
    arrived: Arrived = NOT_ARRIVED

    @property
    def _task(self) -> Task | None:
        return None if self.decision is None else self.decision.task

    @property
    def twist(self) -> np.ndarray:
        """(6,) asked of the camera, optical frame; zero where none was."""
        if self._task is None:
            return np.zeros(6) if self.resolution is None else self.resolution.asked
        return self._task.twist

    @property
    def achieved(self) -> np.ndarray:
        """(6,) of it that the joint velocities give."""
        return np.zeros(6) if self.resolution is None else self.resolution.twist

    @property
    def rank(self) -> int:
        """Of L in its modelled directions."""
        return rank(self.singular_values_L)

    @property
    def singular_values_L(self) -> np.ndarray:
        """Of L in its modelled directions, largest first."""
        if self._task is None:
            return np.zeros(0) if self.resolution is None else self.resolution.singular_values_L
        return self._task.singular_values

    @property
    def names(self) -> tuple[str, ...]:
        """Of the features; none without a decision."""
        return () if self.decision is None else tuple(self.decision.names)

    @property
    def error(self) -> np.ndarray | None:
        """(k,) as measured; None without a decision."""
        return None if self.decision is None else self.decision.error


def check_settings(settings: ServoSettings, names: Sequence[str], limits: Limits) -> None:
    """Refuse settings that do not fit an arm with these joints.

    Raises:
        ConfigurationError: naming the setting, its value and what would be right.
    """
    joints = ", ".join(names)
    if settings.output not in OUTPUTS:
        raise ConfigurationError(f"output '{settings.output}' is unknown: {', '.join(OUTPUTS)}")
    for key in ("hold", "delay", "settle", "lag", "push", "watchdog_images"):
        if not (np.isfinite(getattr(settings, key)) and getattr(settings, key) >= 0.0):
            raise ConfigurationError(f"{key} is {getattr(settings, key)}, it must be >= 0")
    for key in ("watchdog", "longest_step", "stop_time", "approach_speed", "resolve_period"):
        if not (np.isfinite(getattr(settings, key)) and getattr(settings, key) > 0.0):
            raise ConfigurationError(f"{key} is {getattr(settings, key)}, it must be above 0")
    if not settings.duration > 0.0:
        raise ConfigurationError(f"duration is {settings.duration}, it must be above 0 s")
    for key in ("arrived", "lead", "stiffness", "damping"):
        value = np.asarray(getattr(settings, key), float)
        if value.shape not in ((), (len(names),)) or not (value >= 0.0).all():
            raise ConfigurationError(
                f"{key} is {getattr(settings, key)}: one number >= 0, or one for each of {joints}"
            )
    if settings.start is None:
        return
    start = np.asarray(settings.start, float)
    if start.shape != (len(names),) or not np.isfinite(start).all():
        raise ConfigurationError(
            f"the start {settings.start} must be a number for each of {joints}"
        )
    for i in np.flatnonzero((start < limits.lower) | (start > limits.upper)):
        raise ConfigurationError(
            f"the start puts {names[i]} at {start[i]:.6g}, outside its limits "
            f"{limits.lower[i]:.6g} to {limits.upper[i]:.6g}"
        )
