"""The record of a run, one entry per image and per event: all that a diagnosis reads."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..goals.goal import Goal
from ..kinematics.elbow import Elbow
from ..observation.observation import Observation
from ..schemes.base import JointController, Scheme
from .outcomes import Outcome
from .state import ServoSettings, ServoState


@dataclass(frozen=True, eq=False)
class RunContext:
    """What does not change during a run.

    Attributes:
        settings: of the loop. goal, scheme: None where only events are judged.
        jacobian: (6, n) of the arm at joints (n,); None: there is no arm.
        beyond: why the arm cannot be where the goal was taught; '' where it can.
        names: of the n joints. lengths: (n,) of each joint, what counts as much as 1 rad or m.
        narrowed: joints whose limits are narrower than the robot's own, by the parameter.
        folds: elbows of the arm. outside: joints that the goal has beyond their limits.
    """

    settings: ServoSettings
    goal: Goal | None = None
    scheme: Scheme | JointController | None = None
    jacobian: Callable[[np.ndarray], np.ndarray] | None = None
    unreachable_reason: str = ""
    names: tuple[str, ...] = ()
    joint_units: np.ndarray | float = 1.0
    narrowed_limits: Mapping[str, Sequence[str]] = field(default_factory=dict)
    elbows: Sequence[Elbow] = ()
    joints_beyond_limits: Sequence[str] = ()


@dataclass(frozen=True, eq=False)
class JointRecord:
    """The joints at an image, (n,) each: `late`, whether the loop waits for the joint; commanded
    and measured velocities, rad/s or m/s."""

    is_late: np.ndarray
    commanded_velocities: np.ndarray
    measured_velocities: np.ndarray


@dataclass(frozen=True, eq=False)
class ImageRecord:
    """One image.

    Attributes:
        state: of the loop, before the diagnosis: stamp, phase, decision, solution, joints, arrival.
        observation: of the image, without its pixels.
        age: from the exposure to when the answer acts, s.
        is_faulty: whether the scheme failed.
        joints: None before any were measured.
        foreign: other nodes that command joints, by joint.
    """

    state: ServoState
    observation: Observation
    age: float = 0.0
    is_faulty: bool = False
    joints: JointRecord | None = None
    foreign_nodes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class RunEvent:
    """Something that happens between two images.

    Attributes:
        kind: 'started', 'scheme_failed', 'joints_unmeasured', 'halted', 'starved' or 'timed_out'.
        reason: of a failure. outcome: of a halt.
        time: when the watchdog stopped the arm, or after which duration the run ended, s.
        period: of the images before the watchdog stopped the arm, s.
    """

    kind: str
    reason: str = ""
    outcome: Outcome | None = None
    time: float = 0.0
    period: float = 0.0


Record = ImageRecord | RunEvent
