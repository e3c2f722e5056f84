"""Record of a run, with an entry for each image and each event.

The record is the input of the diagnosis.
"""

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
        settings: settings of the loop.
        goal, scheme: goal and scheme of the run; None if only events are diagnosed.
        jacobian: function from joints (n,) to the arm's Jacobian (6, n); None if there is no arm.
        unreachable_reason: why the arm cannot reach the pose at which the goal was taught; '' if it
            can.
        names: names of the n joints.
        joint_units: (n,) motion of each joint, rad or m, that has the same weight as 1 rad of a
            revolute joint.
        narrowed_limits: for each parameter that narrows position limits, the joints whose limits
            are narrower than the robot's own.
        elbows: elbows of the arm.
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


@dataclass(eq=False)
class ImageRecord:
    """Record of one image.

    Attributes:
        state: state of the loop after the image, without the result of the diagnosis.
        observation: observation of the image, without its pixels.
        age: time from the exposure until the command that is computed from the image acts, s.
        is_faulty: whether the scheme failed.
        joints: whether each joint is so far behind its command that the loop waits for it (n,), and
            the commanded and measured velocities (n,), rad/s or m/s; None before the first
            measurement.
        foreign_nodes: name of the other node that commands a joint, by joint name.
    """

    state: ServoState
    observation: Observation
    age: float = 0.0
    is_faulty: bool = False
    joints: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
    foreign_nodes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class RunEvent:
    """An event between two images.

    Attributes:
        kind: 'started', 'scheme_failed', 'joints_unmeasured', 'halted', 'starved' or 'timed_out'.
        reason: reason of a failure.
        outcome: outcome of an event 'halted' or 'joints_unmeasured'; None for the outcome
            'no_joint_states'.
        time: for 'starved' (no new image in time), the time at which the arm was stopped, s; for
            'timed_out', the duration of the run, s.
        period: for 'starved', the period of the images before, s.
    """

    kind: str
    reason: str = ""
    outcome: Outcome | None = None
    time: float = 0.0
    period: float = 0.0


Record = ImageRecord | RunEvent
