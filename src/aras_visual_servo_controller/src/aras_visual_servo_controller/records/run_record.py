"""Record of a run, one entry per image and per event: the input of the diagnosis."""

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
    """Constant data of a run.

    Attributes:
        settings: of the loop.
        goal, scheme: None if only events are diagnosed.
        jacobian: function from joints (n,) to the arm's Jacobian (6, n); None if there is no arm.
        unreachable_reason: why the arm cannot reach the pose where the goal was taught; '' if it
            can.
        names: of the n joints.
        joint_units: (n,) motion of each joint that counts as 1 rad or 1 m.
        narrowed_limits: by parameter, the joints whose limits it makes narrower than the robot's
            own.
        elbows: of the arm.
        joints_beyond_limits: joints that exceed their limits at the goal.
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
    """State of the joints at an image, (n,) each.

    Attributes:
        is_late: whether the loop waits for the joint.
        commanded_velocities, measured_velocities: rad/s or m/s.
    """

    is_late: np.ndarray
    commanded_velocities: np.ndarray
    measured_velocities: np.ndarray


@dataclass(frozen=True, eq=False)
class ImageRecord:
    """Record of one image.

    Attributes:
        state: of the loop, before the diagnosis: stamp, phase, scheme output, joint velocities,
            joints, arrival.
        observation: of the image, without its pixels.
        age: time from the exposure until the command acts, s.
        is_faulty: whether the scheme failed.
        joints: None before any were measured.
        foreign_nodes: other nodes that command joints, by joint.
    """

    state: ServoState
    observation: Observation
    age: float = 0.0
    is_faulty: bool = False
    joints: JointRecord | None = None
    foreign_nodes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class RunEvent:
    """An event between two images.

    Attributes:
        kind: 'started', 'scheme_failed', 'joints_unmeasured', 'halted', 'starved' or 'timed_out'.
        reason: of a failure.
        outcome: of a halt.
        time: when the watchdog stopped the arm, or duration after which the run ended, s.
        period: of the images before the watchdog stopped the arm, s.
    """

    kind: str
    reason: str = ""
    outcome: Outcome | None = None
    time: float = 0.0
    period: float = 0.0


Record = ImageRecord | RunEvent
